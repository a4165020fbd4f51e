"""A measurement that arrives, as a measurement of the present state: the formulas of all channels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .._arrays import Array, symmetric
from ..errors import UfirextError

__all__ = [
    "Effective",
    "Step",
    "at_block",
    "averaged",
    "averaged_lifted",
    "on_time",
    "stamped",
    "through_inverse",
]

# Beyond this condition (balanced) F is singular for our purposes: F^-1 would cost more than ten digits.
CONDITION_LIMIT = 1e10


class Step(NamedTuple):
    """One transition of the past: F, the covariance Q of the noise that entered, and the known B u."""

    F: Array
    Q: Array
    Bu: Array | None = None


class Effective(NamedTuple):
    """A measurement as one of the present state:  z + offset = H x_n + v,  v = v0 - sum_i G[i] w_{n-i}.

    Attributes
    ----------
    H : ndarray, (dim_z, dim_x)
    R : ndarray, (dim_z, dim_z)
        Covariance of v.
    G : tuple of ndarray, (dim_z, dim_x)
        How the newest process noises enter v, newest first; empty for a measurement on time.
    correlation : ndarray, (dim_x, dim_z)
        E[w_n v'] with the newest process noise, -Q G[0]'; zero on time.
    offset : ndarray, (dim_z,)
        What known inputs since the origin require to be added to z.
    """

    H: Array
    R: Array
    G: tuple[Array, ...]
    correlation: Array
    offset: Array


def through_inverse(rows: Array, F: Array) -> Array:
    """The product rows F^-1, or an error that names the way without inverses."""
    from scipy.linalg import matrix_balance

    balanced = matrix_balance(F, permute=False)[0]
    condition = np.linalg.cond(balanced)
    if not condition < CONDITION_LIMIT:
        raise UfirextError(
            "F must be invertible to express a delayed measurement by the present state, "
            f"got a condition number of {condition:.2g}; use the augmented state (method='augmented')"
        )
    return np.asarray(np.linalg.solve(F.T, rows.T).T)


def on_time(H: Array, R: Array) -> Effective:
    """A measurement without delay."""
    rows, states = H.shape
    return Effective(H, R, (), np.zeros((states, rows)), np.zeros(rows))


def stamped(H: Array, R: Array, past: Sequence[Step], delay: int) -> Effective:
    """A measurement of x_{n-delay} as one of x_n.

    G_k = H, G_{i-1} = G_i F_{n-i+1}^-1, Hb = G_0, Rb = R + sum_{i<k} G_i Q_{n-i} G_i'. For a constant model
    G_i = H F^{-k+i}: equation :eq:`late-row`, (6) to (8) of Uribe-Murcia et al. (2018).
    """
    if delay == 0:
        return on_time(H, R)
    G, rows = [], H
    offset = np.zeros(len(H))
    noise = R
    for step in past[len(past) - delay :]:
        rows = through_inverse(rows, step.F)
        G.append(rows)
        noise = noise + rows @ step.Q @ rows.T
        if step.Bu is not None:
            offset = offset + rows @ step.Bu.reshape(-1)
    newest = past[-1]
    return Effective(rows, symmetric(noise), tuple(G[::-1]), -newest.Q @ rows.T, offset)


def averaged(
    H: Array, R: Array, past: Sequence[Step], gamma: float, x: Array | None, P: Array | None
) -> Effective:
    """A measurement k H x_n + (1 - k) H x_{n-1} + v with P(k = 1) = gamma, by its moments over k.

    Equation :eq:`unknown-delay`.

    With Hd = H F^-1, D = H - Hd and m the mean of H x_n - H x_{n-1}: Hm = gamma H + (1 - gamma) Hd and
    Rm = R + (1-gamma)^2 Hd Q Hd' + gamma (1-gamma) (m m' + D P D' + D Q Hd' + Hd Q D' + Hd Q Hd').
    A P below Q is no covariance of x_n: the terms with D and Q are left out then, so that Rm stays one.
    """
    if gamma == 1.0:
        return on_time(H, R)
    if x is None or P is None:
        raise UfirextError(
            "x and P must be given (the filter's prior) where the delay is unknown, got None: averaging over "
            "the delay adds a noise that grows with E[x x']"
        )
    F, Q, Bu = past[-1]
    Hd = through_inverse(H, F)
    D = H - Hd
    G = (1.0 - gamma) * Hd
    offset = np.zeros(len(H)) if Bu is None else G @ Bu.reshape(-1)
    moved = D @ x.reshape(-1) + (0.0 if Bu is None else Hd @ Bu.reshape(-1))
    mixed = D @ Q @ Hd.T
    own = Hd @ Q @ Hd.T
    if np.linalg.eigvalsh(symmetric(P - Q))[0] < -1e-9 * np.abs(Q).max(initial=0.0):
        mixed = np.zeros_like(mixed)  # a P from outside that holds no such noise says nothing of w
    spread = np.outer(moved, moved) + D @ P @ D.T + mixed + mixed.T + own
    noise = R + (1.0 - gamma) ** 2 * own + gamma * (1.0 - gamma) * spread
    return Effective(gamma * H + G, symmetric(noise), (G,), -Q @ G.T, offset)


def averaged_lifted(H: Array, R: Array, gamma: float, x: Array, P: Array) -> tuple[Array, Array]:
    """The same on the state [x_n; x_{n-1}; ..], where no noise of the past appears and F may be singular."""
    if gamma == 1.0:
        return at_block(H, 0, len(x)), R
    now, before = at_block(H, 0, len(x)), at_block(H, 1, len(x))
    D = now - before
    moved = D @ x.reshape(-1)
    spread = np.outer(moved, moved) + D @ P @ D.T
    return gamma * now + (1.0 - gamma) * before, symmetric(R + gamma * (1.0 - gamma) * spread)


def at_block(H: Array, delay: int, size: int) -> Array:
    """H at the block of x_{n-delay} in an augmented state of `size` numbers."""
    rows, states = H.shape
    lifted = np.zeros((rows, size))
    lifted[:, delay * states : (delay + 1) * states] = H
    return lifted
