"""
Lag against error
=================

An estimate of the present has only the past to go by. The state of a few steps ago has
measurements on both sides, and is known better. How much better, and from which lag on waiting
does not pay, follows from the model alone.
"""

import matplotlib.pyplot as plt
import numpy as np

from ufirext import (
    UFIRFilter,
    best_horizon,
    kinematic,
    minimum_variance_gain,
    ufir_gain,
)

plt.style.use("seaborn-v0_8-colorblind")

model = kinematic(order=1, dim=1, dt=1.0, q=0.005, r=4.0)
N = best_horizon(model)
print("horizon from the model:", N)

# %%
# From the gains
# --------------
# ``ufir_gain(model, N, lag)`` aims at the state ``lag`` steps before the newest measurement; its
# ``P`` is the exact error covariance. ``minimum_variance_gain`` is the best that any unbiased
# window of that length can do, and knows Q.

lags = np.arange(N)
gains = {"unbiased FIR": ufir_gain, "minimum variance": minimum_variance_gain}
curves = {
    name: np.array([np.sqrt(np.diag(gain(model, N, int(lag)).P)) for lag in lags])
    for name, gain in gains.items()
}
for name, curve in curves.items():
    best = int(np.argmin(curve[:, 0]))
    print(f"{name:18} now {curve[0, 0]:.3f} m, best at a lag of {best}: {curve[best, 0]:.3f} m")

# %%
# From a run
# ----------
# ``smoothed(lag)`` asks a running filter for an older state; the dots are its errors in 4000
# simulated steps.

rng = np.random.default_rng(0)
steps = 4000
noise = rng.multivariate_normal(np.zeros(2), model.Q, size=steps)
x = np.zeros((steps, 2))
for n in range(1, steps):
    x[n] = model.F @ x[n - 1] + noise[n]
zs = x[:, 0] + 2.0 * rng.standard_normal(steps)

f = UFIRFilter(dim_x=2, dim_z=1, horizon=N)
f.F, f.H, f.Q, f.R = model.F, model.H, model.Q, model.R
asked = lags[::3]
errors = {int(lag): [] for lag in asked}
for n, z in enumerate(zs):
    f.predict()
    f.update(z)
    if n >= N and n % 4 == 0:
        for lag, list_ in errors.items():
            list_.append(f.smoothed(lag)[0].ravel() - x[n - lag])
found = np.array([np.sqrt(np.mean(np.square(list_), axis=0)) for list_ in errors.values()])

# %%
# The state in the middle of the window is known best, and a few steps of waiting already bring
# most of that. Further back it gets worse again: an older state sees fewer measurements before
# it.

figure, panels = plt.subplots(1, 2, figsize=(8, 4), layout="constrained")
for component, (axes, what) in enumerate(zip(panels, ("position, m", "speed, m/s"), strict=True)):
    for (name, curve), line in zip(curves.items(), ("-", "--"), strict=True):
        axes.plot(lags, curve[:, component], line, label=name)
    axes.plot(
        asked,
        found[:, component],
        "o",
        color="black",
        markersize=4,
        label="unbiased FIR, simulated",
    )
    axes.set(xlabel="lag, steps", ylabel=f"RMSE of the {what}", ylim=(0, None))
panels[0].legend(loc="lower right")
figure.suptitle(f"Waiting pays: constant velocity, N = {N}")
plt.show()
