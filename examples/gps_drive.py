"""
A drive whose packets come late or never
========================================

A car drives through two bends. Its GPS fixes travel over a network that loses one in five and
delays the others by up to four seconds, so that they arrive out of order. Each carries its time
stamp. What a filter does with a fix that is three seconds old decides how far it is off.
"""

import matplotlib.pyplot as plt
import numpy as np
from filterpy.kalman import KalmanFilter

from ufirext import DelayKalmanFilter, TimeStamped, UFIRFilter, kinematic

plt.style.use("seaborn-v0_8-colorblind")

# %%
# The drive and the network
# -------------------------
# One fix a second with a standard deviation of 3 m in each direction. ``TimeStamped`` is a value
# that describes the network; ``sample`` sends a series through it and returns what arrives at
# each step.

rng = np.random.default_rng(11)
steps = 240
heading = np.zeros(steps)
heading[60:90], heading[90:150] = np.linspace(0, np.pi / 2, 30), np.pi / 2
heading[150:180], heading[180:] = np.linspace(np.pi / 2, -np.pi / 6, 30), -np.pi / 6
truth = 12.0 * np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)

channel = TimeStamped(4, law=(0.4, 0.2, 0.2, 0.1, 0.1), loss=0.2)
model = kinematic(order=1, dim=2, dt=1.0, q=1.0, r=9.0)
arrivals = channel.sample(rng, truth, R=model.R)
late = sum(packet.delay > 0 for packets in arrivals for packet in packets)
print(f"{steps} fixes, {sum(map(len, arrivals))} arrive, {late} of them late")


# %%
# Four ways to deal with it
# -------------------------
# A filter that has no word for "late" can take an old fix for a new one, or drop it. ``update(z,
# delay=k)`` puts it where it belongs.


def drive(f, update):
    """Positions (steps, 2) that a filter reports after each step's arrivals."""
    f.F, f.H, f.Q, f.R = model.F, model.H, model.Q, model.R
    f.P *= 1000.0
    positions = []
    for packets in arrivals:
        f.predict()
        for packet in packets:
            update(f, packet)
        positions.append(model.H @ f.x.ravel())
    return np.array(positions)


def as_new(f, packet):
    f.update(packet.z)


def drop_late(f, packet):
    if packet.delay == 0:
        f.update(packet.z)


def in_its_place(f, packet):
    f.update(packet.z, delay=packet.delay)


tracks = {
    "KalmanFilter, late taken as new": drive(KalmanFilter(4, 2), as_new),
    "KalmanFilter, late dropped": drive(KalmanFilter(4, 2), drop_late),
    "UFIRFilter, N = 8": drive(UFIRFilter(4, 2, horizon=8), in_its_place),
    "UFIRFilter, adaptive": drive(UFIRFilter(4, 2, horizon="adaptive"), in_its_place),
    "DelayKalmanFilter": drive(DelayKalmanFilter(4, 2, channel=channel), in_its_place),
}
print(f"{'':34}{'RMSE, m':>8}{'worst, m':>10}")
for name, track in tracks.items():
    error = np.hypot(*(track - truth)[20:].T)
    print(f"{name:34}{np.sqrt(np.mean(error**2)):8.2f}{error.max():10.1f}")

# %%
# The first bend
# --------------

figure, (chart, errors) = plt.subplots(
    2, 1, figsize=(7, 7.5), layout="constrained", height_ratios=(3, 2)
)
bend = slice(62, 88)
chart.plot(*truth[bend].T, color="black", linewidth=0.8, label="truth")
for name in (
    "KalmanFilter, late taken as new",
    "UFIRFilter, N = 8",
    "DelayKalmanFilter",
):
    chart.plot(*tracks[name][bend].T, "o-", markersize=3, linewidth=0.8, label=name)
    errors.plot(np.hypot(*(tracks[name] - truth).T), linewidth=1.2, label=name)
chart.set(
    xlabel="east, m",
    ylabel="north, m",
    aspect="equal",
    title="A filter that takes late fixes as new is pulled back",
)
errors.set(
    xlabel="time, s",
    ylabel="distance from the truth, m",
    xlim=(20, steps),
    ylim=(0, 60),
)
chart.legend(loc="upper left")
errors.legend(loc="upper left")
plt.show()
