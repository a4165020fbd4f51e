"""
The H-infinity guarantee and its worst disturbance
==================================================

A Kalman filter is the best on average over random disturbances. Nature need not be random: an
H-infinity filter bounds the energy of its errors by the energy of the disturbances, whatever
these are. Both statements can be checked without any theory, because the largest ratio of the two
energies is a singular value.
"""

import matplotlib.pyplot as plt
import numpy as np

from ufirext import DelayHInfinityFilter, ThetaTooLarge, kinematic, worst_case_gain

plt.style.use("seaborn-v0_8-colorblind")

model = kinematic(order=1, dim=1, dt=1.0, q=0.1, r=1.0)
STEPS = 40


def robust(theta):
    """A filter that keeps sum theta |error|^2 <= energy of disturbances; Kalman's for theta = 0."""
    f = DelayHInfinityFilter(dim_x=2, dim_z=1, theta=theta)
    f.F, f.H, f.Q, f.R = model.F, model.H, model.Q, model.R
    f.weight = np.diag([1.0, 0.0])  # errors of the position count
    return f


# %%
# How much can be guaranteed
# --------------------------
# From a limit on there is no such filter, and the class says so instead of going on.

low, high = 0.0, 10.0
for _ in range(30):
    theta = (low + high) / 2
    f = robust(theta)
    try:
        for _step in range(STEPS):
            f.predict()
            f.update(0.0)
        low = theta
    except ThetaTooLarge:
        high = theta
limit = low
print(f"largest theta for {STEPS} steps: {limit:.4f}")
try:
    f = robust(1.1 * limit)
    for _step in range(STEPS):
        f.predict()
        f.update(0.0)
except ThetaTooLarge as error:
    print("beyond it:", error)

# %%
# The worst disturbance, by singular values
# -----------------------------------------
# ``worst_case_gain`` returns the largest ratio of energies over the coming steps, in units of the
# bound, and the disturbance that attains it. For the Kalman filter the ratio is multiplied by the
# same theta, to be comparable.

theta = 0.98 * limit
worst = {"H-infinity": robust(theta).worst_case_gain(STEPS)}
kalman, gains = robust(0.0), []
for _ in range(STEPS):
    kalman.predict()
    kalman.update(0.0)
    gains.append(kalman.K)
start = robust(0.0)
worst["Kalman"] = worst_case_gain(
    K=gains,
    F=model.F,
    H=model.H,
    Q=model.Q,
    R=model.R,
    P0=start.P,
    S=start.weight,
    theta=theta,
)
for name, case in worst.items():
    print(f"{name:12} largest error energy: {case.gain:.3f} of the bound")

# %%
# What each is worth
# ------------------
# On random disturbances the Kalman filter wins, on the worst ones it breaks the bound. Left: the
# worst disturbances of the two filters, scaled to energy one. Right: the errors that they cause.

figure, (inputs, errors) = plt.subplots(1, 2, figsize=(8, 4), layout="constrained")
for (name, case), line in zip(worst.items(), ("-", "--"), strict=True):
    sign = np.sign(case.errors[3, 0])  # a disturbance and its negative are equally bad
    inputs.plot([sign * v[0] for v in case.v], line, label=name)
    errors.plot(sign * case.errors[:, 0], line, label=name)
inputs.set(xlabel="step", ylabel="noise of the measurement v, m", title="Worst disturbance")
errors.set(xlabel="step", ylabel="error of the position, m", title="What it does")
for axes in (inputs, errors):
    axes.axhline(0, color="black", linewidth=0.8)
    axes.legend()
plt.show()

# %%
# Random disturbances for comparison: 200 runs.

rng = np.random.default_rng(0)
squares = {name: [] for name in worst}
for _run in range(200):
    filters = {"H-infinity": robust(theta), "Kalman": robust(0.0)}
    state = rng.standard_normal(2)
    for w in rng.multivariate_normal(np.zeros(2), model.Q, size=STEPS):
        state = model.F @ state + w
        z = state[0] + rng.standard_normal()
        for name, f in filters.items():
            f.predict()
            f.update(z)
            squares[name].append((f.x[0, 0] - state[0]) ** 2)
for name, values in squares.items():
    print(f"{name:12} RMSE under random disturbances: {np.sqrt(np.mean(values)):.3f} m")
