"""
A certificate for a gain
========================

A gain is a matrix of numbers that came out of a program. ``certify`` asks whether it is the best
unbiased one of its window and does not trust the program: it reports figures that anyone can
recompute, and solves the optimisation problem a second time with a convex solver.
"""

import matplotlib.pyplot as plt
import numpy as np

from ufirext import Gain, certify, kinematic, minimum_variance_gain, ufir_gain

plt.style.use("seaborn-v0_8-colorblind")

model = kinematic(order=1, dim=1, dt=1.0, q=0.05, r=4.0)
HORIZON = 12

# %%
# Three gains
# -----------
# The minimum-variance gain, the unbiased FIR gain, and a minimum-variance gain with one number
# changed in the fourth digit, as by a slip of the pen.

best, unbiased = minimum_variance_gain(model, HORIZON), ufir_gain(model, HORIZON)
slip = best.K.copy()
slip[0, 5] *= 1.0001
altered = Gain(K=slip, G=slip @ slip.T, P=best.P, horizon=HORIZON)

print(f"{'':26}{'optimal':>8}{'unbiased to':>13}{'gap':>10}{'stationary to':>15}   solver")
for name, gain, criterion in (
    ("minimum variance", best, "variance"),
    ("unbiased FIR", unbiased, "variance"),
    ("unbiased FIR, noise alone", unbiased, "noise"),
    ("one digit changed", altered, "variance"),
):
    c = certify(gain, model, criterion=criterion)
    figures = f"{c.feasibility:13.0e}{c.gap:10.0e}{c.stationarity:15.0e}"
    print(f"{name:26}{c.optimal!s:>8}{figures}   {c.solver} {c.status}")

# %%
# The unbiased FIR gain is unbiased, but not of least variance under this Q. It is the optimum of
# another question: the one that asks for the noise of the measurements alone, without knowing Q.
#
# What the two do with the window
# -------------------------------
# The minimum-variance gain trusts old measurements less, by as much as Q says.

figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
age = np.arange(HORIZON)[::-1]
axes.plot(
    age,
    best.K[0],
    "o-",
    markersize=4,
    label=f"minimum variance, error variance {best.P[0, 0]:.2f} m²",
)
axes.plot(
    age,
    unbiased.K[0],
    "s--",
    markersize=4,
    label=f"unbiased FIR, error variance {unbiased.P[0, 0]:.2f} m²",
)
axes.axhline(0, color="black", linewidth=0.8)
axes.set(
    xlabel="age of the measurement, steps",
    ylabel="weight in the position",
    title=f"Gains of a window of {HORIZON}",
)
axes.invert_xaxis()
axes.set_xticks(age[::-1])
axes.legend()
plt.show()

# %%
# A lower bound that needs no solver
# ----------------------------------
# ``dual`` is a number below which no unbiased gain can go, whatever it is; ``primal`` is what
# this one attains.

c = certify(best, model)
print("error variances:", c.primal)
print("lower bounds:   ", c.dual)
