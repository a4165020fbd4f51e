"""Errata of Kim (2019)."""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import block_diag

from ufirext import UnobservableWindow, fms_gain
from validation.claims import AtLeast, AtMost, absolute, relative
from validation.errata.erratum import Erratum, Numbers, errata_item
from validation.errata.literal import Array, power
from validation.item import Item
from validation.papers import S3
from validation.s3.tracking import A, C, D, G, M, Q, R, gain
from validation.study import Study
from validation.vehicle import vehicle

__all__ = ["ITEM"]

B = np.array([[2.0], [2.0], [0.0]])
"""A known acceleration: dt²/2 and dt, dt = 2 s."""


def _noise_maps(d: int) -> tuple[Array, Array]:
    """Λ and Λ~ of (4) and (5), with the minus inside, as defined there."""
    n = len(A)
    blank = np.zeros((1, G.shape[1]))
    Lam = -np.block(
        [[C @ power(A, -(j - r + 1)) @ G if j >= r else blank for j in range(M)] for r in range(M)]
    )
    tail = [np.zeros((n, G.shape[1]))] * (M - d) + [power(A, -(j + 1)) @ G for j in range(d)]
    return Lam, -np.hstack(tail)


def _joint_covariance(d: int) -> Array:
    """Π of (7)."""
    both = np.vstack(_noise_maps(d))
    noise = block_diag(R * np.eye(M), np.zeros((len(A), len(A))))
    return both @ np.kron(np.eye(M), Q) @ both.T + noise


def _gamma(d: int) -> Array:
    n = len(A)
    rows = np.vstack([C @ power(A, -(M - r)) for r in range(M)])
    return np.block([[rows, np.zeros((M, n))], [power(A, -d), -np.eye(n)]])


def _lagged(study: Study) -> Numbers:
    """The lagged position under a known, constant acceleration, no noise."""
    inputs = np.full((M, 1), 0.1)
    x = [np.array([5.0, 1.0, 0.0])]
    for u in inputs:
        x.append(A @ x[-1] + B @ u)
    printed = power(A, -D) @ x[-1]
    for j in range(D):
        printed = printed + power(A, -(j + 1)) @ B @ inputs[M - D + j]
    found = fms_gain(A, C, Q, R, M, D, B=B, G=G)
    _, lagged = found.estimate([C @ state for state in x[:-1]], inputs)
    return Numbers(float(printed[0]), float(lagged[0]), float(x[M - D][0]), absolute(1e-8), unit="m")


def _definite(study: Study) -> Numbers:
    values = np.linalg.eigvalsh(_joint_covariance(1))
    ratio = float(abs(values[0]) / values[-1])
    return Numbers(AtLeast(1e-12, "positive definite"), ratio, AtMost(1e-14, "singular"))


def _solved(study: Study) -> Numbers:
    """(14) at d = 1 by solve(): no error is raised. The truth is least squares for x_{i-1} alone."""
    n = len(A)
    Pi, Gam = _joint_covariance(1), _gamma(1)
    try:
        weighted = np.linalg.solve(Pi, Gam).T
        H = np.linalg.solve(weighted @ Gam, weighted)[n:, :M]
    except np.linalg.LinAlgError:  # where rounding happens to leave an exact zero
        H = np.full((n, M), np.inf)
    Lam, tilde = _noise_maps(1)
    # The error of x_{i-1} by any gain on Z: H (Γ x_i + Λ W + V) - x_{i-1}, x_{i-1} = A^-1 x_i + Λ~ W.
    rest = H @ Lam - tilde
    biased = H @ _gamma(1)[:M, :n] - power(A, -1)
    printed = rest @ np.kron(np.eye(M), Q) @ rest.T + R * H @ H.T + biased @ biased.T
    Lam_lagged = Lam - _gamma(1)[:M, :n] @ A @ tilde
    S = Lam_lagged @ np.kron(np.eye(M), Q) @ Lam_lagged.T + R * np.eye(M)
    rows = _gamma(1)[:M, :n] @ A
    truth = np.linalg.inv(rows.T @ np.linalg.solve(S, rows))
    ours = gain(M, 1).P[n:, n:]
    # Both the truth and ours invert a matrix of condition 1e7.
    return Numbers(float(printed[0, 0]), float(ours[0, 0]), float(truth[0, 0]), relative(1e-6), unit="m²")


def _necessary(study: Study) -> Numbers:
    """Two states, both measured."""
    F = np.array([[1.0, 1.0], [0.0, 1.0]])
    shortest = next(m for m in (1, 2, 3) if _determined(F, np.eye(2), m))
    ranks = [np.linalg.matrix_rank(np.vstack([power(F, i) for i in range(m)])) for m in (1, 2, 3)]
    return Numbers(2, shortest, ranks.index(2) + 1, absolute(0.0))


def _sufficient(study: Study) -> Numbers:
    """A rotation by half a turn each step, one coordinate measured, M = 50."""
    F, row = -np.eye(2), np.array([[1.0, 0.0]])
    try:
        fms_gain(F, row, np.eye(2), 1.0, 50, 1)
        rank: int | None = 2
    except UnobservableWindow as error:
        rank = error.rank
    O = np.vstack([row @ power(F, i) for i in range(50)])  # noqa: E741
    return Numbers(2, math.nan if rank is None else rank, float(np.linalg.matrix_rank(O)), absolute(0.0))


def _determined(F: Array, H: Array, window: int) -> bool:
    try:
        fms_gain(F, H, np.eye(len(F)), np.eye(len(H)), window, 0)
    except UnobservableWindow:
        return False
    return True


def _products(study: Study) -> Numbers:
    """Products for x_i of a plant with two measured components."""
    car = vehicle()
    n, q = car.dim_x, car.dim_z
    H = fms_gain(car.F, car.H, car.Q, car.R, M, D).H
    window = [(row, component) for row in range(M) for component in range(q)]
    return Numbers(n * M, H[:n].size, n * len(window), absolute(0.0))


ITEM: Item = errata_item(
    S3,
    [
        Erratum(
            "(5)",
            "lagged position with a known input, no noise",
            "A^{-d} x_i - Ξ~ U - Λ~ W",
            "+ Ξ~ U + Λ~ W: the minus is inside Ξ~ and Λ~",
            _lagged,
        ),
        Erratum(
            "(7)",
            "smallest / largest eigenvalue of Π, d = 1",
            "Π is positive definite",
            "it is singular unless noise reaches all states in d steps",
            _definite,
        ),
        Erratum(
            "(14)",
            "variance of the lagged position, d = 1, by solve()",
            "(Γ'Π^{-1}Γ)^{-1} Γ'Π^{-1}",
            "the form without Π^{-1}; the printed one raises no error here, and is wrong",
            _solved,
        ),
        Erratum("theorem 1", "shortest M, both of two states measured", "M ≥ n", "1 is enough", _necessary),
        Erratum(
            "theorem 1",
            "rank of 50 rows of a rotation by half a turn",
            "M ≥ n makes the estimate exact",
            "no M does; the window must determine the states",
            _sufficient,
        ),
        Erratum(
            "Table 1", "products for x_i, two components measured", "n M", "n M q for each output", _products
        ),
    ],
    "(6) has A - d - 1 for the block row [A^{-d}, -I]; (12) has arg error for arg min; what Table 2 calls "
    "RMS is another metric: see s3-table-2.",
)
