"""The rows of one series, whitened, whatever the model does from step to step.

States are homogeneous, [x; 1], so that known inputs and measurements are entries of matrices: a step is
G = [F, B u; 0, 1], a row A = W [H, -z] says A [x; 1] = noise of unit covariance. Late rows are moved to a
common age: with D the longest delay, a row that came at step k is one of the state of step k - D.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._arrays import Array
from ..engines.records import Limits
from ..window import R_FLOOR, whitener
from .request import Request
from .windows import Mask

__all__ = ["Rows", "rows_of"]

# Rows with less than this fraction of the window's largest information count as missing.
NEGLIGIBLE = 1e-8
# Longest delay that is worth moving rows by.
LONGEST = 64


@dataclass(frozen=True)
class Rows:
    """One series.

    Attributes
    ----------
    G : (T, n + 1, n + 1)
        Homogeneous transitions into each step.
    A : (T, m, n + 1)
        Whitened homogeneous rows by arrival, zero where a component is missing, each of its own origin.
    came : (T,) of bool
    delays : (T,) of int
    longest : int
        D.
    """

    G: Array
    A: Array
    came: Mask
    delays: NDArray[np.int64]
    longest: int

    def step(self, number: int) -> Array:
        """G of a step; before the series the first transition without inputs."""
        if number >= 0:
            return np.asarray(self.G[number])
        first = np.array(self.G[0])
        first[:-1, -1] = 0.0
        return first

    def steps(self, numbers: NDArray[np.int64]) -> Array:
        """The same for many."""
        chosen = np.asarray(self.G[np.maximum(numbers, 0)])
        chosen[numbers < 0, :-1, -1] = 0.0
        return chosen

    def shifted(self) -> tuple[Array, Array]:
        """G and A of the states D steps before."""
        if not self.longest:
            return self.G, self.A
        numbers, A = np.arange(len(self.A)), self.A.copy()
        for older in range(self.longest):
            active = older < self.longest - self.delays
            A[active] = A[active] @ self.steps(numbers[active] - self.delays[active] - older)
        return self.steps(numbers - self.longest), A

    def recent(self, states: Array, lag: int) -> Array:
        """Homogeneous states (T, n + 1, 1) of D + lag steps before each step, moved on by D."""
        numbers = np.arange(len(states)) - lag
        for older in range(self.longest - 1, -1, -1):
            states = self.steps(numbers - older) @ states
        return states


def rows_of(request: Request, series: int, limits: Limits) -> Rows | None:
    """The rows of one series; None where only a filter that goes step by step has them."""
    model, changing = request.model, request.per_step
    z, n = np.asarray(request.z[series], dtype=float), model.dim_x
    delays = np.zeros(len(z), dtype=np.int64) if request.delays is None else request.delays[series]
    H = np.broadcast_to(model.H if changing.H is None else changing.H, (len(z), *model.H.shape))
    present = ~np.isnan(z) & H.any(axis=2) & (delays < limits.reach)[:, None]
    came: Mask = np.asarray(present.any(axis=1))
    longest = int(delays[came].max(initial=0))
    if longest and (longest > LONGEST or not request.by_arrival):
        return None
    W = _whiteners(request, present)
    if W is None:
        return None
    A = W @ np.concatenate([H, -np.where(present, z, 0.0)[:, :, None]], axis=2)
    information = np.einsum("tmn,tmn->t", A[:, :, :n], A[:, :, :n])[came]
    if information.min(initial=np.inf) < n * NEGLIGIBLE * information.max(initial=0.0):
        return None
    G = np.zeros((len(z), n + 1, n + 1))
    G[:, :n, :n] = model.F if changing.F is None else changing.F
    G[:, n, n] = 1.0
    if request.us is not None and model.B is not None:
        G[:, :n, n] = request.us[series] @ model.B.T
    return Rows(G, A, came, np.where(came, delays, 0), longest)


def _whiteners(request: Request, present: Mask) -> Array | None:
    """W with W R W' = I on the components present, zero elsewhere; None where an R is nearly singular."""
    m = request.model.dim_z
    if request.per_step.R is None and present.all():
        return whitener(request.model.R).reshape(1, m, m)
    R = np.broadcast_to(
        request.model.R if request.per_step.R is None else request.per_step.R, (len(present), m, m)
    )
    kept = present[:, :, None] & present[:, None, :]
    scale = np.sqrt(np.maximum(np.einsum("tii->ti", R), 0.0))
    if (scale[present] <= 0.0).any():
        return None
    unit = 1.0 / np.where(scale > 0.0, scale, 1.0)
    if np.count_nonzero(R) == np.count_nonzero(scale):
        return np.where(present, unit, 0.0)[:, :, None] * np.eye(m)
    alike = np.where(kept, R, np.eye(m)) * np.where(kept, unit[:, :, None] * unit[:, None, :], 1.0)
    if np.linalg.eigvalsh(alike).min(initial=1.0) <= R_FLOOR * m:
        return None
    lower = np.linalg.cholesky(alike)
    return np.asarray(np.linalg.solve(lower, np.eye(m) * np.where(present, unit, 0.0)[:, None, :]))
