"""Optimal gains as convex programs for cvxpy: what a certificate compares a gain with."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.linalg import solve_triangular

from ._arrays import Array
from .errors import UfirextError
from .joint import square_root
from .regression import Regression, row_sizes

__all__ = ["Objective", "Solution", "literal_program", "objective_program", "universal_program"]

Objective = Literal["lambda_max"] | Array

# Beyond this condition of the transitions the paper's problem, which inverts them, is not posed.
INVERTIBLE = 1e8
# Rows of noise below this fraction of what they are the difference of are zero.
ROUNDING = 1e-12
# First-order solvers stop at 1e-4 unless told otherwise.
_PRECISION: dict[str, dict[str, Any]] = {
    "OSQP": {"eps_abs": 1e-12, "eps_rel": 1e-12, "max_iter": 200_000},
    "SCS": {"eps_abs": 1e-12, "eps_rel": 1e-12, "max_iters": 200_000},
}


@dataclass(frozen=True)
class Solution:
    """What a solver returned: the gain on whitened rows (None if it has none), and its own words."""

    gain: Array | None
    value: float
    solver: str
    status: str
    seconds: float


def universal_program(problem: Regression, solver: str) -> Solution:
    """min ||E - H N||_F^2 subject to H O = T, for any transitions: H in units where the noise is white."""
    cp = _cvxpy()

    space = _Whitened(problem)
    X = cp.Variable(space.aim.shape)
    program = cp.Problem(cp.Minimize(cp.sum_squares(X - space.aim)), [X @ space.basis == space.fixed])
    status, seconds = _solve(program, solver)
    if X.value is None:
        return Solution(None, np.nan, solver, status, seconds)
    gain = space.gain(X.value)
    return Solution(gain, float((problem.errors(gain) ** 2).sum()), solver, status, seconds)


def objective_program(problem: Regression, objective: Objective, solver: str) -> Solution:
    """The least lambda_max(P) ("lambda_max") or trace(W P) (W, a weight matrix) of all unbiased gains."""
    cp = _cvxpy()

    space = _Whitened(problem)
    X = cp.Variable(space.aim.shape)
    root = np.eye(len(space.unit)) if isinstance(objective, str) else square_root(objective)
    weights = root.T * space.unit
    # Scaled by the value at a feasible gain, so that the solver's tolerances mean something.
    known = weights @ np.hstack([space.start - space.aim, space.rest])
    size = float(np.linalg.norm(known, 2 if isinstance(objective, str) else None))
    errors = (weights / size) @ cp.hstack([X - space.aim, space.rest])
    cost = cp.sigma_max(errors) if isinstance(objective, str) else cp.norm(errors, "fro")
    program = cp.Problem(cp.Minimize(cost), [X @ space.basis == space.fixed])
    status, seconds = _solve(program, solver)
    value = np.nan if program.value is None else (float(program.value) * size) ** 2
    return Solution(None, value, solver, status, seconds)


def literal_program(problem: Regression, solver: str) -> Solution | None:
    """min tr(H Pi H') subject to H Gamma = I: problem (12), (11) of Kim (2019), about the newest target.

    Pi may be singular, as it often is: only its root is used. None where the transitions cannot be inverted.
    First-order solvers do not reach the end of this badly conditioned problem: CLARABEL stands in for them.
    """
    cp = _cvxpy()

    n, rows = problem.O.shape[1], len(problem.O)
    newest = problem.T[:n]
    if np.linalg.cond(newest / np.maximum(row_sizes(newest), np.finfo(float).tiny)[:, None]) > INVERTIBLE:
        return None
    stacked = np.vstack([problem.O, problem.T[n:]])
    back: Array = np.asarray(np.linalg.solve(newest.T, stacked.T)).T
    more = len(problem.T) - n
    Gamma = np.hstack([back, np.vstack([np.zeros((rows, more)), -np.eye(more)])])
    root, scale = _literal_noise(problem, back)
    basis, triangle = np.linalg.qr(Gamma / scale[:, None])
    fixed = solve_triangular(triangle, np.eye(len(triangle)))
    size = np.sqrt((fixed**2).sum(axis=1))[:, None]
    X = cp.Variable((len(fixed), len(scale)))
    program = cp.Problem(
        cp.Minimize(cp.sum_squares(X @ _narrow(root / scale[:, None]))), [X @ basis == fixed / size]
    )
    solver = "CLARABEL" if solver in _PRECISION else solver
    status, seconds = _solve(program, solver)
    if X.value is None:
        return Solution(None, np.nan, solver, status, seconds)
    gain = (X.value * size / scale)[:, :rows]
    return Solution(gain, float((problem.errors(gain) ** 2).sum()), solver, status, seconds)


def _literal_noise(problem: Regression, back: Array) -> tuple[Array, Array]:
    """A root of Pi and the sizes of its rows; rows that are zero but for rounding are made so."""
    n = problem.O.shape[1]
    kept, removed = np.vstack([problem.N, problem.E[n:]]), back @ problem.E[:n]
    root, scale = kept - removed, row_sizes(kept - removed)
    empty = scale <= ROUNDING * np.hypot(row_sizes(kept), row_sizes(removed))
    return np.where(empty[:, None], 0.0, root), np.where(empty, 1.0, scale)


class _Whitened:
    """H N = X Q', Q a basis of N's rows: min |X - aim| subject to X basis = fixed, in rows of size 1."""

    def __init__(self, problem: Regression) -> None:
        frame, self.triangle = np.linalg.qr(problem.N.T)
        aim = problem.E @ frame
        O = solve_triangular(self.triangle, problem.O, trans="T")  # noqa: E741
        white = Regression(O, np.eye(len(O)), problem.T, aim)
        self.basis, inverse, _ = white.decomposed
        fixed = problem.T @ inverse
        start = fixed @ self.basis.T
        rest = _narrow(problem.E - aim @ frame.T)
        unit = np.hypot(row_sizes(start - aim), row_sizes(rest))
        self.unit = np.where(unit > 0.0, unit, 1.0)
        self.aim, self.fixed, self.start, self.rest = (
            a / self.unit[:, None] for a in (aim, fixed, start, rest)
        )

    def gain(self, X: Array) -> Array:
        """The gain on whitened rows."""
        return np.asarray(solve_triangular(self.triangle, (X * self.unit[:, None]).T).T)


def _narrow(A: Array) -> Array:
    """A lower trapezoidal matrix with the same A A'."""
    return np.asarray(np.linalg.qr(A.T, mode="r")).T


def _cvxpy() -> Any:
    """The modelling language, imported where it is used: it takes a second."""
    try:
        import cvxpy
    except ImportError as error:
        raise UfirextError("a certificate needs cvxpy, which is not installed: pip install cvxpy") from error
    return cvxpy


def _solve(program: Any, solver: str) -> tuple[str, float]:
    """Solve; the status is cvxpy's, or says how the solver failed."""
    cp = _cvxpy()

    installed = cp.installed_solvers()
    if solver not in installed:
        raise UfirextError(f"solver must be installed, one of {', '.join(installed)}, got {solver!r}")
    begin = time.perf_counter()
    with warnings.catch_warnings():
        # An inaccurate solution is told by the status, which the certificate names.
        warnings.filterwarnings("ignore", message="Solution may be inaccurate")
        try:
            program.solve(solver=solver, **_PRECISION.get(solver, {}))
            status = str(program.status)
        except cp.SolverError as error:
            status = f"failed: {error}"
    return status, time.perf_counter() - begin
