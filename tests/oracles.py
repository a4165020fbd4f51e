"""Independent oracles: naive, slow, and free of any code of ufirext.

Everything is solved from scratch by numpy.linalg.lstsq on stacked equations, so these functions share neither
formulas nor rounding with the library. Times are integers; ``transitions[j]`` leads from j - 1 to j.

======================  =====================================================================================
phi                     F_j .. F_{i+1}
stacked                 C, D, E, V of a window: Z = C x_old + D w + v,  x_aim = T x_old + E w
least_squares           weighted least squares over records: estimate, gain (on raw rows), exact covariance
brute_force_covariance  (E - K D) Q (E - K D)' + K R K' for any gain
book_kalman             the Kalman filter of the books over a series
======================  =====================================================================================

The streaming oracle that is built from them is in naive_filter.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Record:
    """A measurement z = H x_origin + v, cov v = R, that came at step `arrival`. Flat z, (m,)."""

    origin: int
    arrival: int
    H: Array
    R: Array
    z: Array


class Constant(Mapping[int, Array]):
    """The same matrix at every time."""

    def __init__(self, value: Array) -> None:
        self.value = np.asarray(value, dtype=float)

    def __getitem__(self, time: int) -> Array:
        return self.value

    def __iter__(self):
        raise TypeError("a constant has no end")

    def __len__(self) -> int:
        raise TypeError("a constant has no length")


def phi(transitions: Mapping[int, Array], to: int, start: int) -> Array:
    """F_to .. F_{start+1}, the identity for to = start."""
    product = np.eye(len(transitions[to]))
    for time in range(start + 1, to + 1):
        product = transitions[time] @ product
    return product


@dataclass(frozen=True)
class Stacked:
    """Z = C x_old + D w + v with w = [w_{old+1}; ..; w_end], and x_aim = T x_old + E w."""

    C: Array
    D: Array
    V: Array
    T: Array
    E: Array
    Qs: Array
    Z: Array


def stacked(
    records: Sequence[Record], transitions: Mapping[int, Array], noises: Mapping[int, Array], aim: int
) -> Stacked:
    """The regression of `records` (in the order given) in the state at their oldest origin."""
    old = min([aim, *(record.origin for record in records)])
    end = max([aim, *(record.origin for record in records)])
    n, steps = records[0].H.shape[1], end - old

    def into(time: int) -> Array:
        """How w reaches the state at `time`: (n, steps * n)."""
        blocks = [
            phi(transitions, time, j) if j <= time else np.zeros((n, n)) for j in range(old + 1, end + 1)
        ]
        return np.hstack(blocks) if blocks else np.zeros((n, 0))

    return Stacked(
        C=np.vstack([r.H @ phi(transitions, r.origin, old) for r in records]),
        D=np.vstack([r.H @ into(r.origin) for r in records]),
        V=block_diagonal([r.R for r in records]),
        T=phi(transitions, aim, old),
        E=into(aim),
        Qs=block_diagonal([noises[j] for j in range(old + 1, end + 1)]) if steps else np.zeros((0, 0)),
        Z=np.concatenate([r.z for r in records]),
    )


def block_diagonal(blocks: Sequence[Array]) -> Array:
    size = sum(len(block) for block in blocks)
    result, at = np.zeros((size, size)), 0
    for block in blocks:
        result[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return result


def determined(C: Array, T: Array) -> bool:
    """T null(C) = 0, the null space taken from column-scaled rows."""
    scale = np.linalg.norm(C, axis=0)
    scale[scale == 0] = 1.0
    _, s, Vt = np.linalg.svd(C / scale, full_matrices=True)
    rank = int((s > 1e-10 * s[0]).sum()) if s[0] > 0 else 0
    left = (T / scale) @ Vt[rank:].T
    return bool((np.linalg.norm(left, axis=1) <= 1e-8 * np.linalg.norm(T / scale, axis=1)).all())


def naive_gain(window: Stacked) -> Array:
    """K = T (W C)+ W by lstsq on column-scaled whitened rows, W'W = V^-1."""
    W = np.linalg.inv(np.linalg.cholesky(window.V))
    white = W @ window.C
    scale = np.linalg.norm(white, axis=0)
    scale[scale == 0] = 1.0
    inverse = np.linalg.lstsq(white / scale, W, rcond=1e-11)[0]
    return (window.T / scale) @ inverse


def brute_force_covariance(window: Stacked, K: Array) -> Array:
    """(E - K D) Q (E - K D)' + K V K' of an unbiased gain."""
    left = window.E - K @ window.D
    return left @ window.Qs @ left.T + K @ window.V @ K.T


def least_squares(
    records: Sequence[Record], transitions: Mapping[int, Array], noises: Mapping[int, Array], aim: int
) -> tuple[Array, Array, Array]:
    """Estimate of x_aim, gain on the stacked raw rows, and exact error covariance."""
    window = stacked(records, transitions, noises, aim)
    K = naive_gain(window)
    return K @ window.Z, K, brute_force_covariance(window, K)


def observability_index(F: Array, H: Array, longest: int = 60) -> int | None:
    """The first N with F^{N-1} null(C_N) = 0."""
    C, power = H, np.eye(len(F))
    for horizon in range(1, longest + 1):
        if determined(C, power):
            return horizon
        power = F @ power
        C = np.vstack([C, H @ power])
    return None


def kalman_update(x: Array, P: Array, z: Array, H: Array, R: Array) -> tuple[Array, Array]:
    """The book's measurement update, flat x and z."""
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    left = np.eye(len(x)) - K @ H
    return x + K @ (z - H @ x), left @ P @ left.T + K @ R @ K.T


def book_kalman(
    F: Array,
    H: Array,
    Q: Array,
    R: Array,
    x0: Array,
    P0: Array,
    zs: Sequence[Array | None],
    us: Sequence[Array] | None = None,
) -> tuple[Array, Array]:
    """Filtered states (T, n) and covariances (T, n, n); us[t] is B u at step t; None in zs: no row."""
    x, P = np.array(x0, dtype=float), np.array(P0, dtype=float)
    states, covariances = [], []
    for t, z in enumerate(zs):
        x, P = F @ x + (0 if us is None else us[t]), F @ P @ F.T + Q
        if z is not None:
            x, P = kalman_update(x, P, z, H, R)
        states.append(x)
        covariances.append(P)
    return np.array(states), np.array(covariances)
