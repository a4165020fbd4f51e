"""
Choosing the horizon
====================

A short window averages little noise; a long one believes its model for longer than it is true.
The best horizon is where the two meet. It can be had from a model that is trusted, or from
recorded data, without Q and R.
"""

import matplotlib.pyplot as plt
import numpy as np

from ufirext import best_horizon, kinematic, ufir_gain

plt.style.use("seaborn-v0_8-colorblind")

# %%
# Where the error comes from
# --------------------------
# The gain does not depend on Q. Its error covariance does, and the two parts add up: what the
# noise of the measurements contributes (Q = 0), and what the state does meanwhile.

model = kinematic(order=1, dim=1, dt=1.0, q=0.01, r=4.0)
still = model.replace(Q=np.zeros((2, 2)))
horizons = np.arange(3, 61)
total = np.array([ufir_gain(model, int(N)).P[0, 0] for N in horizons])
noise = np.array([ufir_gain(still, int(N)).P[0, 0] for N in horizons])
N = best_horizon(model)
print("from the model:", N)
print("closed form for constant velocity:", round(float(np.sqrt(12 * 2.0 / 0.1))))

# %%
# From data
# ---------
# ``best_horizon(model, zs)`` scores every horizon by how well it predicts the next measurement.
# The model given to it here has a Q that is wrong by a factor of a hundred; it is not used.

rng = np.random.default_rng(3)
steps = 20_000
state = np.zeros(2)
zs, truth = np.empty(steps), np.empty(steps)
for n, w in enumerate(rng.multivariate_normal(np.zeros(2), model.Q, size=steps)):
    state = model.F @ state + w
    truth[n] = state[0]
    zs[n] = state[0] + 2.0 * rng.standard_normal()

wrong = model.replace(Q=model.Q / 100)
print("from a model whose Q is 100 times too small:", best_horizon(wrong))
print("from 2000 measurements:", best_horizon(wrong, zs[:2000]))
print("from the first 100 of them:", best_horizon(wrong, zs[:100]))

# %%
# How much it matters
# -------------------
# The errors that these windows really make on the series, and what half and twice the best horizon
# cost. The curve is flat around its minimum, and too short is a smaller mistake than too long.

best = np.sqrt(ufir_gain(model, N).P[0, 0])
for horizon in (N // 2, 2 * N):
    worse = np.sqrt(ufir_gain(model, horizon).P[0, 0]) / best
    print(f"horizon {horizon}: {100 * (worse - 1):.0f} % more error than with {N}")

found = []
for horizon in horizons[::3]:
    K = ufir_gain(model, int(horizon)).K[0]
    estimates = np.convolve(zs, K[::-1], mode="valid")
    found.append(np.sqrt(np.mean((estimates - truth[len(K) - 1 :]) ** 2)))

figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
axes.plot(horizons, np.sqrt(total), label="all of it")
axes.plot(horizons, np.sqrt(noise), "--", label="from the measurements' noise")
axes.plot(horizons, np.sqrt(total - noise), "-.", label="from what the state does meanwhile")
axes.plot(
    horizons[::3],
    found,
    "o",
    color="black",
    markersize=4,
    label="on the simulated series",
)
axes.axvline(N, color="grey", linewidth=0.8)
axes.annotate(f"best_horizon: {N}", (N, 0.1), xytext=(6, 0), textcoords="offset points")
axes.set(
    xlabel="horizon, steps",
    ylabel="RMSE of the position, m",
    ylim=(0, 3),
    title="Constant velocity, standard deviation of a measurement 2 m",
)
axes.set_xlim(0, 48)
axes.legend(loc="upper center")
plt.show()
