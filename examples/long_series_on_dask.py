"""
A long series, split over Dask
==============================

A year of readings of a clock against a reference, one a minute, half a million in all. The offset
is noisy, and the rate of the clock wanders. A recursive filter has to go through the year in
order. An estimate with a finite memory depends on the last N readings alone, so that the year can
be cut into parts which are filtered apart, each preceded by an overlap of N - 1 readings. That is
exact.
"""

import dask
import matplotlib.pyplot as plt
import numpy as np

from ufirext import distributed, filter_series, kinematic

plt.style.use("seaborn-v0_8-colorblind")

# %%
# The clock
# ---------
# Offset in nanoseconds, time in hours. The readings have a standard deviation of 20 ns.

rng = np.random.default_rng(8)
minutes = 365 * 24 * 60
model = kinematic(order=1, dim=1, dt=1 / 60, q=0.5, r=20.0**2)
noise = rng.standard_normal((minutes, 2)) @ np.linalg.cholesky(model.Q).T
rate = np.cumsum(noise[:, 1])
offset = np.cumsum(noise[:, 0] + np.concatenate([[0.0], rate[:-1]]) / 60)
readings = offset + 20.0 * rng.standard_normal(minutes)
N = 600

# %%
# Lazily, in parts
# ----------------
# The result is a Dask array. Nothing is computed until it is asked for, and then on whatever Dask
# computes with: threads here, a cluster elsewhere. ``chunks`` is optional; the overlap is chosen.

estimate = distributed.filter_series(model, readings, horizon=N, chunks=2**16)
print(estimate.x)
print("parts:", estimate.x.numblocks[0], " overlap:", estimate.overlap)
with dask.config.set(scheduler="threads"):
    x = estimate.x.compute()

error = x[:, 0] - offset
print(f"readings off by {np.std(readings - offset):.1f} ns")
print(f"estimates by {np.sqrt(np.nanmean(error**2)):.1f} ns")

# %%
# The same numbers as in one piece
# --------------------------------

whole = filter_series(model, readings, horizon=N)
same = np.nanmax(np.abs(x - whole.x)) / np.nanmax(np.abs(whole.x))
print(f"largest difference from the series in one piece, relative: {same:.0e}")

# %%
# What the overlap is for
# -----------------------
# Around the first cut: the estimate in parts, and what the second part would say alone. Until its
# window is full it knows only what came since the cut, and before that nothing at all.

cut = 2**16
alone = filter_series(model, readings[cut : cut + 4 * N], horizon=N).x[:, 0]
around = slice(cut - 2 * N, cut + 3 * N)
hours = (np.arange(minutes) - cut) / 60

figure, axes = plt.subplots(figsize=(7, 4.2), layout="constrained")
axes.plot(
    hours[around],
    (readings - offset)[around],
    ".",
    color="lightgrey",
    markersize=2,
    label="readings",
)
axes.plot(hours[around], error[around], linewidth=3.5, alpha=0.5, label="with overlap")
first = slice(cut + 20, cut + 3 * N)
axes.plot(hours[first], alone[20 : 3 * N] - offset[first], "--", label="second part without it")
axes.axvline(0, color="grey", linewidth=0.8)
axes.axvline(N / 60, color="grey", linewidth=0.8, linestyle=":")
axes.set(xlabel="hours since the cut", ylabel="error of the offset, ns", ylim=(-40, 40))
axes.set_title("A cut through the series; the dotted line is one horizon later")
axes.legend(loc="lower right", markerscale=5)
plt.show()

# %%
# Files larger than memory go through ``distributed.filter_file``, series with named dimensions
# through ``distributed.filter_dataarray``.
