"""
A filterpy script, one import changed
=====================================

A cart rolls along a rail at a constant speed and its position is measured every second. The
script was written for ``filterpy.kalman.KalmanFilter``; the function below does not know which
class it is given. At 100 s somebody pushes the cart: its speed changes at once, and nothing in
the model says so.
"""

from functools import partial

import matplotlib.pyplot as plt
import numpy as np
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter

from ufirext import UFIRFilter

plt.style.use("seaborn-v0_8-colorblind")


def tracked(make_filter, zs):
    """The script as it was, with the class for an argument."""
    f = make_filter(dim_x=2, dim_z=1)
    f.F = np.array([[1.0, 1.0], [0.0, 1.0]])
    f.H = np.array([[1.0, 0.0]])
    f.P *= 100.0
    f.R *= 4.0
    f.Q = Q_continuous_white_noise(dim=2, dt=1.0, spectral_density=1e-5)
    xs = []
    for z in zs:
        f.predict()
        f.update(z)
        xs.append(f.x.ravel())
    return np.array(xs), f


# %%
# The measurements
# ----------------
# Standard deviation 2 m; the push adds 1.5 m/s.

rng = np.random.default_rng(4)
time = np.arange(250.0)
speed = np.where(time < 100, 3.0, 4.5)
truth = np.cumsum(speed)
zs = truth + 2.0 * rng.standard_normal(len(time))

# %%
# Three runs of one script
# ------------------------
# ``functools.partial`` gives the class an argument. Without one the horizon is ``"auto"`` and
# follows from ``F, H, Q, R``. Here Q says that the speed hardly ever changes, so ``"auto"`` is
# long. ``"adaptive"`` reads the horizon off the measurements as they come and does not need Q.

runs = {
    "KalmanFilter (filterpy)": tracked(KalmanFilter, zs),
    "UFIRFilter, auto": tracked(UFIRFilter, zs),
    "UFIRFilter, adaptive": tracked(partial(UFIRFilter, horizon="adaptive"), zs),
}

print(f"{'':26}{'before':>8}{'100 s after':>13}{'later':>8}   RMSE of the position, m")
for name, (xs, _) in runs.items():
    error = xs[:, 0] - truth
    parts = [
        np.sqrt(np.mean(error[span] ** 2))
        for span in (slice(50, 100), slice(100, 200), slice(200, 250))
    ]
    print(f"{name:26}{parts[0]:8.2f}{parts[1]:13.2f}{parts[2]:8.2f}")
print("horizon chosen from the model:", runs["UFIRFilter, auto"][1].horizon)

# %%
# What was pushed is forgotten
# ----------------------------
# The Kalman filter remembers the time before the push with slowly fading weights. The FIR filter
# has forgotten it completely as soon as its window holds newer measurements alone, however wrong
# its Q was: with the long horizon that takes as many seconds as the horizon has steps, with the
# adaptive one a few. What that costs is seen before the push and long after it, where Q was right
# and a short window averages less noise than a long one.

figure, (top, bottom) = plt.subplots(2, 1, figsize=(7, 6), sharex=True, layout="constrained")
for (name, (xs, _)), line in zip(runs.items(), ("-", "--", "-."), strict=True):
    top.plot(time, xs[:, 0] - truth, line, label=name)
    bottom.plot(time, xs[:, 1], line, label=name)
bottom.plot(time, speed, color="black", linewidth=0.8, label="truth")
top.set_ylabel("error of the position, m")
bottom.set(ylabel="speed, m/s", xlabel="time, s", ylim=(2, 6))
for axes in (top, bottom):
    axes.axvline(100, color="grey", linewidth=0.8)
    axes.legend()
top.set_title("A push at 100 s that no model knew of")
plt.show()

# %%
# What the window knows besides
# -----------------------------
# The same filter gives the state of some steps ago, better than it was known then, and takes
# measurements that come late. See :class:`ufirext.UFIRFilter`.

f = runs["UFIRFilter, adaptive"][1]
x, P = f.smoothed(lag=5)
print(f"now:          {f.x[0, 0]:8.2f} m, standard deviation {np.sqrt(f.P[0, 0]):.2f} m")
print(f"5 s ago:      {x[0, 0]:8.2f} m, standard deviation {np.sqrt(P[0, 0]):.2f} m")
