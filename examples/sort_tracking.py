"""
Boxes through a video: SORT
===========================

SORT (:cite:t:`bewley2016`) follows boxes through a video with a Kalman filter for each. The
implementation in :download:`sort_boxes.py <../../examples/sort_boxes.py>`, to be put beside this
script, takes the class of the filter as an argument and does not know which one it runs. The
state is centre, area, aspect ratio and the rates of the first three.

The scene is made to be awkward: pedestrians walk at constant velocity, then turn back at once,
and one detection in ten is missing. Pixels throughout.
"""

import matplotlib.pyplot as plt
import numpy as np

from sort_boxes import FILTERS, Scene, main, track

plt.style.use("seaborn-v0_8-colorblind")

# %%
# Scores
# ------
# Three scenes of six objects and 200 frames. An identity switch is an object that is continued
# under another number.

main(Scene(), seeds=range(3))

# %%
# A turn, seen closely
# --------------------
# One object of one scene around the frame in which it turns back. The window of six frames has
# forgotten the old direction six frames later.

rng = np.random.default_rng(1)
scene = Scene(objects=3, frames=160)
truth = scene.truth(rng)
frames = list(scene.detections(truth, rng))
centre = truth[:, 0, [0, 2]].mean(axis=1)
turn = int(np.argmax(centre))
shown = range(turn - 15, turn + 30)

figure, axes = plt.subplots(figsize=(7, 3.6), layout="constrained")
for name, line in zip(("KalmanFilter (filterpy)", "UFIRFilter, N = 6"), ("o-", "s-"), strict=True):
    found = {}
    for frame, boxes in enumerate(track(frames, FILTERS[name])):
        for box in boxes.values():
            if frame in shown and abs(box[[1, 3]].mean() - truth[frame, 0, [1, 3]].mean()) < 60:
                found[frame] = box[[0, 2]].mean() - centre[frame]
    axes.plot(found.keys(), found.values(), line, markersize=3, linewidth=1, label=name)
axes.set(xlabel="frame", ylabel="error, horizontal, px", title="A pedestrian turns back")
axes.axhline(0, color="black", linewidth=0.8)
axes.axvline(turn, color="grey", linewidth=0.8)
axes.legend()
plt.show()
