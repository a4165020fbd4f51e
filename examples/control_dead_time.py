"""
A control loop with dead time
=============================

A cart on a rail is held in place through a field bus that delays its force by four samples, under
gusts, by a noisy position sensor. State feedback needs the speed and the forces under way: an
estimator. python-control brings the Kalman filter; ``ufirext.control`` puts a finite-memory one in
its place, and the loop stays a linear system.
"""

import sys

import control as ct
import matplotlib.pyplot as plt
import numpy as np

from ufirext.control import create_ufir_iosystem, norm, with_dead_time

plt.style.use("seaborn-v0_8-colorblind")

dt, delay = 0.05, 4
QN, RN = np.array([[0.3]]), np.array([[0.02**2]])  # gusts, N^2, and sensor, m^2, of one sample

cart = ct.c2d(ct.ss([[0, 1], [0, -0.2]], [[0, 0], [1, 1]], [[1, 0]], [[0, 0]]), dt)
cart = ct.ss(cart, inputs=["force", "gust"], outputs=["position"], name="cart")
plant = with_dead_time(cart, input_delay=delay, control_indices=["force"], name="plant")
print("states:", plant.state_labels)
print("smallest pole of A:", abs(plant.poles()).min())

# %%
# Feedback and two estimators
# ---------------------------
# The gain is designed for the plant with its dead time, whose A is singular. The horizon is the
# best one for these noises. ``dlqe`` gives python-control's Kalman filter in its steady state, as a
# linear system with the same signals.

K, *_ = ct.dlqr(plant[:, "force"], np.diag([100.0, 1.0] + [0.0] * delay), [[1.0]])
ufir = create_ufir_iosystem(plant, "auto", RN, QN=QN, disturbance_indices=["gust"], name="ufir")
print(
    "horizon:",
    ufir.horizon,
    "samples; signals:",
    ufir.input_labels,
    "to",
    len(ufir.output_labels),
    "estimates",
)


def steady_kalman(told):
    """The Kalman filter for gusts of variance `told`, and its error system."""
    L, P, _ = ct.dlqe(plant[:, "gust"], told, RN)
    A, B, G = plant.A - L @ plant.C, plant.B[:, :1], plant.B[:, 1:]
    states = np.eye(plant.nstates)
    names = {"outputs": ufir.output_labels, "name": "kalman"}
    filter_ = ct.ss(A, np.hstack([L, B]), states, 0, dt, inputs=ufir.input_labels, **names)
    error = ct.ss(
        A, np.hstack([G, -L]), states, 0, dt, inputs=["w[0]", "v[0]"], outputs=ufir.output_labels
    )
    return filter_, error, P


kalman, kalman_error, P = steady_kalman(QN)
ufir_error = ufir.error_system(error_labels=ufir.output_labels)
print("speed error, m/s rms: UFIR", end=" ")
scale = ct.ss([], [], [], np.diag(np.sqrt([QN[0, 0], RN[0, 0]])), dt)
print(f"{norm((ufir_error * scale)[1, :]):.3f}, Kalman {norm((kalman_error * scale)[1, :]):.3f}")


# %%
# The loop, with the noises as inputs
# -----------------------------------
# Plant, sensor, estimator and feedback are connected by the names of their signals. The loop with
# the FIR estimator is a ``StateSpace`` as the other one is: it has poles, and norms. Its slowest
# pole is that of the state feedback, whatever the horizon. The norm from the noises to
# (10 position, speed, force) is the root of what the feedback was designed to keep small.

motion = ct.ss(plant.A, plant.B, np.eye(2, plant.nstates), 0, dt, inputs=plant.input_labels)


def closed(estimator):
    """Inputs gust and noise; outputs true position, true speed, and force."""
    feedback = ct.ss([], [], [], -K, dt, inputs=estimator.output_labels, outputs="force", name="K")
    sensor = ct.summing_junction(["true", "noise"], "position", name="sensor")
    return ct.interconnect(
        [ct.ss(motion, outputs=["true", "speed"], name="plant"), sensor, estimator, feedback],
        inputs=["gust", "noise"],
        outputs=["true", "speed", "force"],
    )


def cost(loop):
    """Root of the mean of 100 position^2 + speed^2 + force^2 under the noises as they are."""
    return norm(ct.ss([], [], [], np.diag([10.0, 1.0, 1.0]), dt) * loop * scale)


poles = [abs(closed(estimator).poles()).max() for estimator in (ufir, kalman)]
print(f"slowest pole: UFIR {poles[0]:.4f}, Kalman {poles[1]:.4f}")
print(f"cost: UFIR {cost(closed(ufir)):.3f}")
for factor in (0.01, 0.1, 1.0, 10.0, 100.0):
    wrong = closed(steady_kalman(factor * QN)[0])
    print(f"  Kalman, told {factor:g} times the gusts' variance: {cost(wrong):.3f}")

# %%
# Where the truth is told, the Kalman filter is the best there is; the FIR estimator, which was told
# a horizon, comes close. A filter that was told too little trusts its model too much.
#
# A push, and what remains of it
# ------------------------------
# For half a second somebody pushes with 4 N. One of the Kalman filters is the nonlinear system that
# ``create_estimator_iosystem`` makes, told a hundredth of the gusts. The window has forgotten the
# push when its last sample has left it.

steps, push = 240, slice(60, 70)
time = np.arange(steps) * dt
rng = np.random.default_rng(1)
noises = np.vstack(
    [np.sqrt(QN) * rng.standard_normal(steps), np.sqrt(RN) * rng.standard_normal(steps)]
)
noises[0, push] += 4.0
estimator = ct.create_estimator_iosystem(
    plant,
    QN / 100,
    RN,
    disturbance_indices=["gust"],
    measurement_labels=["position"],
    name="kalman",
)
start = np.concatenate([np.zeros(2 * plant.nstates), steady_kalman(QN / 100)[2].ravel()])
runs = {
    "UFIR": ct.input_output_response(closed(ufir), time, noises),
    "Kalman, Q right": ct.input_output_response(closed(kalman), time, noises),
    "Kalman, Q / 100": ct.input_output_response(closed(estimator), time, noises, start),
}
for name, run in runs.items():
    away = np.abs(run.outputs[0, push.stop :])
    print(
        f"{name:16} at most {away.max():.2f} m away,"
        f" {np.sqrt((away[40:] ** 2).mean()):.2f} m rms from 2 s later on"
    )

# %%
# Left: how much of a sinusoidal gust, and of sinusoidal sensor noise, is left in the error of the
# speed. Right: the run.

omega = np.geomspace(0.3, np.pi / dt, 400)
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
_, careful_error, _ = steady_kalman(QN / 100)
errors = {"UFIR": ufir_error, "Kalman, Q right": kalman_error, "Kalman, Q / 100": careful_error}
for (name, error), color in zip(errors.items(), ("C0", "C2", "C1"), strict=True):
    gain = np.abs(ct.frequency_response(error, omega).complex[1])
    left.loglog(omega, gain[0], "-", color=color, label=name)
    left.loglog(omega, gain[1], "--", color=color)
    right.plot(time, runs[name].outputs[0], color=color, label=name)
left.plot([], [], "k-", label="from the gust, per N")
left.plot([], [], "k--", label="from the sensor, per m")
left.set(
    xlabel="frequency, rad/s",
    ylabel="speed error, m/s",
    title="What reaches the estimate",
    ylim=(1e-3, 20),
)
left.legend(fontsize=8, loc="lower left")
right.axvspan(time[push.start], time[push.stop], color="0.85", label="push of 4 N")
right.set(xlabel="time, s", ylabel="position of the cart, m", title="The loop after a push")
right.legend(fontsize=8)
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=120)
