"""Two oracles of the best linear unbiased estimate of [x_now; x_aim], free of any code of ufirext.

diffuse_kalman  the book's Kalman filter with a cloned state, from P = kappa I, in as many digits as it takes
lstsq_pair      one whitened least-squares problem in the oldest state and all the process noise, in doubles
"""

from __future__ import annotations

from dataclasses import dataclass

import mpmath
import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Case:
    """`rows` measurements of x_0 .. x_{rows-1}; wanted are x_now and x_aim, aim <= now >= rows - 1."""

    F: Array
    H: Array
    Q: Array
    R: Array
    rows: int
    now: int
    aim: int


def paper_case(A, C, Q, R, M: int, d: int) -> Case:
    """x_i and x_{i-d} from z_{i-M} .. z_{i-1}."""
    return Case(*(np.atleast_2d(np.asarray(a, dtype=float)) for a in (A, C, Q, R)), rows=M, now=M, aim=M - d)


def library_case(model, horizon: int, lag: int) -> Case:
    """x_n and x_{n-lag} from z_{n-horizon+1} .. z_n."""
    return Case(model.F, model.H, model.Q, model.R, rows=horizon, now=horizon - 1, aim=horizon - 1 - lag)


def diffuse_kalman(case: Case, digits: int = 150, log_kappa: int = 50) -> tuple[Array, Array]:
    """Gain (2n, rows * m) and joint covariance; exact up to 10^-log_kappa."""
    with mpmath.workdps(digits):
        F, H, Q, R = (mpmath.matrix(a.tolist()) for a in (case.F, case.H, case.Q, case.R))
        n, m = F.rows, H.rows
        pair_H = mpmath.zeros(m, 2 * n)
        pair_H[:, :n] = H
        K, P = mpmath.zeros(2 * n, case.rows * m), mpmath.eye(2 * n) * mpmath.mpf(10) ** log_kappa
        for time in range(case.now + 1):
            if time:
                K[:n, : time * m] = F * K[:n, : time * m]
                P[:n, :] = F * P[:n, :]
                P[:, :n] = P[:, :n] * F.T
                P[:n, :n] += Q
            if time == case.aim:
                K[n:, :], P[n:, n:] = K[:n, :], P[:n, :n]
                P[:n, n:], P[n:, :n] = P[:n, :n], P[:n, :n]
            if time < case.rows:
                step = P * pair_H.T * mpmath.inverse(pair_H * P * pair_H.T + R)
                if time:
                    K[:, : time * m] -= step * (H * K[:n, : time * m])
                K[:, time * m : (time + 1) * m] = step
                left = mpmath.eye(2 * n) - step * pair_H
                P = left * P * left.T + step * R * step.T
        return as_doubles(K), as_doubles(P)


def as_doubles(matrix: mpmath.matrix) -> Array:
    return np.array(matrix.tolist(), dtype=float).reshape(matrix.rows, matrix.cols)


def factor(Q: Array) -> Array:
    """S S' = Q."""
    values, vectors = np.linalg.eigh(Q)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def lstsq_pair(case: Case) -> tuple[Array, Array]:
    """Gain and joint covariance from min |V^-1/2 (Z - C x_0 - D w)|^2 + |w|^2, cov w scaled to I."""
    n, m, steps = len(case.F), len(case.H), case.now
    S = factor(case.Q)
    into = np.zeros((n, n + steps * n))
    into[:, :n] = np.eye(n)
    states = [into]
    for time in range(steps):
        into = case.F @ into
        into[:, n + time * n : n + (time + 1) * n] += S
        states.append(into)
    white = np.linalg.inv(np.linalg.cholesky(case.R))
    seen = np.vstack([white @ case.H @ states[t] for t in range(case.rows)])
    known = np.hstack([np.zeros((steps * n, n)), np.eye(steps * n)])
    A = np.vstack([seen, known])
    scale = np.linalg.norm(A, axis=0)
    scale[scale == 0.0] = 1.0
    wanted = np.vstack([states[case.now], states[case.aim]]) / scale
    # The gain on [Z; 0] whitened by V: lstsq against the identity gives the pseudo-inverse.
    inverse = np.linalg.lstsq(A / scale, np.eye(len(A)), rcond=1e-12)[0]
    joint = wanted @ inverse
    whiten_all = np.kron(np.eye(case.rows), white)
    return joint[:, : case.rows * m] @ whiten_all, joint @ joint.T


def row_error(K: Array, reference: Array) -> float:
    """Largest error of a row relative to that row."""
    size = np.linalg.norm(reference, axis=1)
    return float((np.linalg.norm(K - reference, axis=1) / np.where(size > 0, size, 1.0)).max())
