"""
A fleet: many tracks in lock step
=================================

A radar follows two thousand aircraft. Every scan brings the position of most of them; some are
missed, some reports come a scan late, aircraft enter and leave. ``Fleet`` is what that many
``UFIRFilter`` objects would compute, with one matrix product a scan.
"""

import time

import matplotlib.pyplot as plt
import numpy as np

from ufirext import Fleet, UFIRFilter, kinematic

plt.style.use("seaborn-v0_8-colorblind")

TRACKS, SCANS, SCAN, SIGMA = 2000, 60, 4.0, 60.0  # s, m

model = kinematic(order=1, dim=2, dt=SCAN, q=0.5, r=SIGMA**2)
fleet = Fleet(model, horizon=8, tracks=TRACKS)

# %%
# The traffic
# -----------
# Straight flights with a bend. One report in ten is missing; one in twenty is a scan old. The
# window of eight scans is chosen for the straight parts; in a bend it lags.

rng = np.random.default_rng(5)
position = rng.uniform(-100e3, 100e3, (TRACKS, 2))
heading = rng.uniform(0, 2 * np.pi, TRACKS)
rate = np.zeros((SCANS, TRACKS))
rate[25:45] = rng.choice([-0.01, 0.0, 0.01], TRACKS)  # rad/s
course = heading + SCAN * np.cumsum(rate, axis=0)
velocity = 220.0 * np.stack([np.cos(course), np.sin(course)], axis=2)
truth = position + SCAN * np.cumsum(velocity, axis=0)  # (scans, tracks, 2)
seen = truth + SIGMA * rng.standard_normal(truth.shape)
missed = rng.random((SCANS, TRACKS)) < 0.1
late = rng.random((SCANS, TRACKS)) < 0.05

# %%
# Scan by scan
# ------------
# NaN is a report that did not come, ``delay`` the age of each in scans. A slot that is left can
# be joined by another aircraft, which is NaN until its own reports determine its state.

estimates, ready = np.full((SCANS, TRACKS, 2), np.nan), []
started = time.perf_counter()
for scan in range(SCANS):
    delay = np.where(late[scan] & (scan > 0), 1, 0)
    Z = seen[scan - delay, np.arange(TRACKS)]
    Z[missed[scan]] = np.nan
    if scan == 30:
        fleet.leave(np.arange(200))  # 200 aircraft land; as many others take off
        joined = fleet.join(200)
    X = fleet.step(Z, delay)
    estimates[scan] = X[:, [0, 2]]
    ready.append(int(fleet.ready.sum()))
fleet_seconds = time.perf_counter() - started

error = np.linalg.norm(estimates - truth, axis=2)
print(f"memory of the fleet: {fleet.nbytes / 1e6:.1f} MB")
print(f"a report is off by {np.sqrt(2) * SIGMA:.0f} m (RMS)")
print(f"an estimate by     {np.sqrt(np.nanmean(error[10:25] ** 2)):.0f} m in straight flight")
bends = np.nanmean(error[30:45, rate[30] != 0] ** 2)
print(f"                   {np.sqrt(bends):.0f} m in a bend")

# %%
# The same as one filter each
# ---------------------------
# Twenty of the tracks once more, with ``UFIRFilter``: the same numbers, and the time that it
# takes.

chosen = np.arange(1000, 1020)
worst = 0.0
started = time.perf_counter()
for track in chosen:
    f = UFIRFilter(dim_x=4, dim_z=2, horizon=8)
    f.F, f.H, f.Q, f.R = model.F, model.H, model.Q, model.R
    for scan in range(SCANS):
        f.predict()
        if missed[scan, track]:
            f.update(None)
        elif late[scan, track] and scan > 0:
            f.update(seen[scan - 1, track], delay=1)
        else:
            f.update(seen[scan, track])
        if f.ready:
            worst = max(worst, np.abs(f.x[[0, 2], 0] - estimates[scan, track]).max())
each_seconds = (time.perf_counter() - started) / len(chosen) * TRACKS
print(f"largest difference: {worst:.1e} m")
print(f"{TRACKS} single filters would take {each_seconds / fleet_seconds:.0f} times as long")

# %%
# The screen
# ----------

figure, axes = plt.subplot_mosaic(
    [["screen", "one"], ["ready", "ready"]],
    figsize=(9, 6.5),
    layout="constrained",
    height_ratios=(3, 1),
)
for track in range(0, TRACKS, 40):
    axes["screen"].plot(*estimates[:, track].T / 1e3, linewidth=1)
one = int(np.flatnonzero(rate[30] != 0)[-1])
bend = slice(18, 45)
axes["one"].plot(*truth[bend, one].T / 1e3, color="black", linewidth=0.8, label="truth")
axes["one"].plot(*seen[bend, one].T / 1e3, "o", markersize=3, label="reports")
axes["one"].plot(*estimates[bend, one].T / 1e3, label="estimate")
axes["one"].legend()
for name, title in (("screen", "Fifty of the tracks"), ("one", "One of them in its bend")):
    axes[name].set(xlabel="east, km", ylabel="north, km", title=title, aspect="equal")
axes["ready"].step(range(SCANS), ready, where="mid")
axes["ready"].set(xlabel="scan", ylabel="tracks ready", ylim=(0, 1.1 * TRACKS))
plt.show()

# %%
# Save and go on
# --------------
# ``fleet.save(path)`` writes the whole state to the bit and ``Fleet.load(path)`` goes on from
# there.
