"""Hypothesis strategies: random models of every kind the library promises to handle.

Arrays are drawn by a NumPy generator from a drawn seed: dense examples, quickly, and still reproducible.
"""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from ufirext import Model

KINDS = ("stable", "unstable", "marginal", "oscillating", "singular", "delayed", "nilpotent")

seeds = st.integers(0, 2**32 - 1)
lags = st.integers(0, 4)


def transition(rng: np.random.Generator, n: int, kind: str) -> np.ndarray:
    """A random (n, n) transition matrix; `kind` fixes where its eigenvalues lie."""
    if kind == "delayed":
        return delay_augmented(rng, n)
    if kind == "nilpotent":
        return np.triu(rng.normal(size=(n, n)), 1)
    basis = np.linalg.qr(rng.normal(size=(n, n)))[0] * rng.uniform(0.5, 2.0, n)
    if kind == "oscillating":
        core = np.eye(n) * rng.uniform(0.9, 1.0)
        for i in range(0, n - 1, 2):
            angle = rng.uniform(0.2, 2.5)
            core[i : i + 2, i : i + 2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        return basis @ core @ np.linalg.inv(basis)
    low, high = {
        "stable": (0.3, 0.95),
        "unstable": (0.8, 1.15),
        "marginal": (1.0, 1.0),
        "singular": (0.4, 1.0),
    }[kind]
    core = np.diag(rng.uniform(low, high, n) * rng.choice([-1.0, 1.0], n)) + 0.4 * np.triu(
        rng.normal(size=(n, n)), 1
    )
    if kind == "marginal":
        core = np.eye(n) + np.diag(rng.uniform(0.3, 1.2, n - 1), 1)
    if kind == "singular":
        core[0, 0] = 0.0
    return basis @ core @ np.linalg.inv(basis)


def delay_augmented(rng: np.random.Generator, n: int) -> np.ndarray:
    """[x; x_-1; ..]: a scalar or two-state plant with its past, poles at 0."""
    size = 2 if n >= 4 else 1
    F = np.zeros((n, n))
    F[:size, :size] = np.eye(size) + np.triu(rng.normal(size=(size, size)), 1)
    for row in range(size, n):
        F[row, row - size] = 1.0
    return F


def positive(rng: np.random.Generator, n: int, *, rank: int | None = None) -> np.ndarray:
    """A random covariance of the given rank (full by default), moderately conditioned."""
    rank = n if rank is None else rank
    factor = rng.normal(size=(n, rank)) * rng.uniform(0.3, 2.0, n)[:, None]
    ridge = 0.1 * np.eye(n) if rank == n else 0.0
    P = factor @ factor.T / max(rank, 1) + ridge
    return 0.5 * (P + P.T)


def random_model(seed: int, n: int, m: int, kind: str, *, quiet: bool = False) -> Model:
    """A model of dim_x n, dim_z m; `quiet` has no process noise. Observable or not, as it happens."""
    rng = np.random.default_rng(seed)
    F = transition(rng, n, kind)
    H = rng.normal(size=(m, n))
    Q = (
        np.zeros((n, n))
        if quiet
        else rng.uniform(0.01, 1.0) * positive(rng, n, rank=int(rng.integers(0, n + 1)))
    )
    return Model(F, H, Q=Q, R=positive(rng, m))


@st.composite
def models(draw, kinds=KINDS, max_x: int = 5, max_z: int = 3, quiet: bool = False) -> Model:
    """Any model, observable with probability one unless F is defective."""
    n = draw(st.integers(1, max_x))
    m = draw(st.integers(1, min(n, max_z)))
    return random_model(draw(seeds), n, m, draw(st.sampled_from(kinds)), quiet=quiet)


@st.composite
def unobservable_models(draw, max_x: int = 5) -> Model:
    """A model with a mode that no row sees; it may decay, but it never dies."""
    n = draw(st.integers(2, max_x))
    rng = np.random.default_rng(draw(seeds))
    F = np.zeros((n, n))
    F[: n - 1, : n - 1] = transition(rng, n - 1, draw(st.sampled_from(("stable", "marginal", "unstable"))))
    F[-1] = rng.normal(size=n)
    F[-1, -1] = rng.uniform(0.5, 1.1)
    H = np.hstack([rng.normal(size=(1, n - 1)), np.zeros((1, 1))])
    return Model(F, H, Q=positive(rng, n), R=1.0)
