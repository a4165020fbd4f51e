"""A constant model and a series with holes: normal equations in an orthonormal basis, for all steps at once.

With the rows U_i of the basis, x^ = T back Lam^-1 eta, eta = sum_i U_i' z_i and Lam = sum_i U_i' U_i over the
rows that are there. Both are convolutions, of the measurements with zeros in the holes and of the holes
themselves, and Lam is close to the identity: nothing is lost by normal equations. The few windows for which
that does not hold, or which must reach further back, are solved one by one.
"""

from __future__ import annotations

from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from .._arrays import Array
from ..engines.records import Limits
from ..gains import least_squares, observability_index
from ..model import Model
from ..window import Window
from .batched import positive_solution
from .growth import Basis, basis_of
from .plan import SeriesPlan
from .request import Request
from .toeplitz import Convolution, convolution, convolve

__all__ = ["HolePlan", "Holes", "hole_plan", "present_in"]

Mask = NDArray[np.bool_]

# Square of a pivot lost digits: windows with a smaller one are solved by orthogonal transformations.
WEAK_PIVOT = 0.03
# Windows that grow share bases of so many rows, and then of twice as many each.
FIRST_BASIS = 8
# Steps that are worked out together.
PIECE = 8192
# Patterns of holes whose gains are kept.
PATTERNS = 4096
# A component beside which others have less than this fraction of the information counts as missing there.
NEGLIGIBLE = 1e-8


class HolePlan:
    """What a plan knows beforehand about windows with holes."""

    def __init__(self, plan: SeriesPlan, extends: bool) -> None:
        self.plan, model = plan, plan.model
        index = observability_index(model) or 1
        self.limits = Limits(plan.horizon, index + 2, extends, True)
        self.wanted = min(plan.horizon, index + 2) if extends else 0
        self._gains: dict[bytes, Array | None] = {}

    @cached_property
    def basis(self) -> Basis | None:
        """Of the full window, None where it is ill conditioned."""
        return basis_of(self.plan.model, self.plan.horizon)

    def holds(self, present: Mask) -> bool:
        """Whether series with these holes (T, dim_z) can be solved here."""
        if self.basis is None or not self.plan.unbiased:
            return False
        model = self.plan.model
        if (present.any(axis=1) == present.all(axis=1)).all():
            return True
        information = (model.H**2).sum(axis=1) / np.where(model.R.diagonal() > 0, model.R.diagonal(), 1.0)
        independent = np.count_nonzero(model.R) == np.count_nonzero(model.R.diagonal()) == len(model.R)
        return independent and bool(information.min() > NEGLIGIBLE * information.sum())

    @cached_property
    def eta(self) -> Convolution:
        """From measurements to eta."""
        basis = self._known(self.basis)
        return convolution(basis.raw)

    @cached_property
    def Lam(self) -> Convolution:
        """From the mask of components to the upper triangle of Lam."""
        return convolution(_squares(self._known(self.basis)))

    def aim(self, basis: Basis) -> Array:
        """From coefficients in a basis to the state that is wanted, `lag` before the basis' newest row."""
        model, length = self.plan.model, len(basis.white)
        return np.asarray(np.linalg.matrix_power(model.F, length - 1 - self.plan.lag) @ basis.back)

    @staticmethod
    def _known(basis: Basis | None) -> Basis:
        if basis is None:
            raise RuntimeError("this window has no basis")
        return basis

    def gain(self, present: Mask) -> Array | None:
        """Gain on the components present, flat, of a window (span, dim_z) up to now; None: not determined."""
        key = np.packbits(present).tobytes() + len(present).to_bytes(8, "little")
        if key not in self._gains:
            if len(self._gains) >= PATTERNS:
                self._gains.clear()
            self._gains[key] = _gain(self.plan.model, present, self.plan.lag)
        return self._gains[key]


def _squares(basis: Basis) -> Array:
    """U_i[m]' U_i[m], upper triangles: (length, dim_z, n (n + 1) / 2)."""
    rows, columns = np.triu_indices(basis.white.shape[2])
    return np.ascontiguousarray(basis.white[:, :, rows] * basis.white[:, :, columns])


def _gain(model: Model, present: Mask, lag: int) -> Array | None:
    steps = np.flatnonzero(present.any(axis=1))
    if not len(steps):
        return None
    first, last = int(steps[0]), len(present) - 1
    oldest = min(first, last - lag)
    masks = [present[step] for step in steps]
    window = Window(
        F=[model.F] * (last - oldest),
        Q=[model.Q] * (last - oldest),
        H=[model.H[mask] for mask in masks],
        R=[model.R[np.ix_(mask, mask)] for mask in masks],
        origins=(steps - oldest).tolist(),
        aim=last - lag - oldest,
    )
    return least_squares(window) if window.determined() else None


class Holes:
    """One series of a constant model with holes: which windows need what."""

    def __init__(self, plan: HolePlan, z: Array, present: Mask, missing: str) -> None:
        self.plan, self.z, self.present = plan, np.where(present, z, 0.0), present
        self.came: Mask = np.asarray(present.any(axis=1))
        horizon, steps = plan.plan.horizon, len(z)
        self.total = np.concatenate([[0], np.cumsum(self.came)])
        starts = np.maximum(np.arange(steps) - horizon + 1, 0)
        self.inside = self.total[1:] - self.total[starts]
        # Coasting is a prediction from the last estimate; lagged states are always asked of the window.
        self.coasts = missing == "extend" and not plan.plan.lag
        self.solved = self.came if self.coasts else np.ones(steps, dtype=np.bool_)
        reached = np.maximum(np.arange(steps) - plan.limits.reach + 1, 0)
        older = self.total[starts] - self.total[reached] > 0
        self.short = plan.limits.extends & (self.inside < plan.wanted) & older
        # Rows of H that see nothing are no holes.
        lost = np.concatenate([[0], np.cumsum((present != plan.plan.model.H.any(axis=1)).any(axis=1))])
        self.broken = lost[1:] > lost[starts]

    def fill(self, x: Array, ready: Mask) -> None:
        """Estimates of windows with holes into x (T, dim_x), which has those of the others; `ready` too."""
        plan = self.plan
        wanted = self.solved & self.broken
        sound = np.zeros_like(wanted)
        begin = plan.plan.horizon - 1
        for start in range(0, len(x), PIECE):
            stop = min(start + PIECE, len(x))
            if wanted[max(start, begin) : stop].any():
                self._full(max(start, begin), stop, x, sound, wanted & ~self.short)
        self._growing(min(begin, len(x)), x, sound, wanted & ~self.short)
        for step in np.flatnonzero(wanted & ~sound).tolist():
            found = self._alone(step)
            sound[step] = found is not None
            x[step] = np.nan if found is None else found
        ready[wanted] = sound[wanted]
        late = np.arange(len(x)) < plan.plan.lag
        ready[late] = False
        x[late] = np.nan
        if self.coasts:
            self._coast(x, ready)

    def _full(self, start: int, stop: int, x: Array, sound: Mask, wanted: Mask) -> None:
        """Windows of the whole length that end in start .. stop - 1."""
        plan = self.plan
        basis = plan._known(plan.basis)
        first = start - plan.plan.horizon + 1
        eta = _slice(plan.eta, self.z[first:stop])
        Lam = _slice(plan.Lam, self.present[first:stop].astype(float))
        self._store(basis, eta.T, Lam.T, start, stop, x, sound, wanted)

    def _growing(self, stop: int, x: Array, sound: Mask, wanted: Mask) -> None:
        """Windows that begin with the series, by cumulative sums in bases of doubling length."""
        low, length = 0, FIRST_BASIS
        while low < stop:
            high = min(length, stop)
            basis = basis_of(self.plan.plan.model, length) if wanted[low:high].any() else None
            if basis is not None:
                eta = np.einsum("im,imr->ir", self.z[:high], basis.raw[:high]).cumsum(axis=0)
                Lam = np.einsum("im,imr->ir", self.present[:high], _squares(basis)[:high]).cumsum(axis=0)
                # The basis ends with its own newest row, the windows each with theirs: only T differs.
                self._store(basis, eta[low:].T, Lam[low:].T, low, high, x, sound, wanted, moving=True)
            low, length = high, 2 * length

    def _store(
        self,
        basis: Basis,
        eta: Array,
        Lam: Array,
        start: int,
        stop: int,
        x: Array,
        sound: Mask,
        wanted: Mask,
        moving: bool = False,
    ) -> None:
        n = len(eta)
        whole = np.empty((n, n, stop - start))
        rows, columns = np.triu_indices(n)
        whole[rows, columns] = whole[columns, rows] = Lam
        solution, fine = positive_solution(whole, eta, WEAK_PIVOT, np.ones_like(eta))
        chosen = fine & wanted[start:stop]
        steps = start + np.flatnonzero(chosen)
        if moving:
            lag = self.plan.plan.lag
            steps = steps[steps >= lag]
            coefficients = basis.back @ solution[:, steps - start]
            x[steps] = _transported(self.plan.plan.model.F, coefficients, steps - lag)
        else:
            x[steps] = (self.plan.aim(basis) @ solution[:, chosen]).T
        sound[steps] = True

    def _alone(self, step: int) -> Array | None:
        """One window, as far back as it must reach; None where the rows do not determine the state."""
        limits = self.plan.limits
        floor = max(step - limits.reach + 1, 0)
        begin = max(step - limits.horizon + 1, 0)
        while True:
            older = np.flatnonzero(self.came[floor:begin])
            if self.total[step + 1] - self.total[begin] >= self.plan.wanted or not len(older):
                window = slice(begin, step + 1)
                gain = self.plan.gain(self.present[window])
                if gain is not None:
                    return np.asarray(gain @ self.z[window][self.present[window]])
                if not len(older) or not limits.extends:
                    return None
            begin = floor + int(older[-1])

    def _coast(self, x: Array, ready: Mask) -> None:
        """Steps without a measurement are predictions, as long as the window reaches enough rows."""
        F, steps = self.plan.plan.model.F, np.arange(len(x))
        last: NDArray[np.int64] = np.maximum.accumulate(np.where(self.came, steps, -1))
        unborn = np.flatnonzero(np.less(last, 0))
        x[unborn], ready[unborn] = np.nan, False
        gap = np.where(last < 0, 0, steps - last)
        certain = self.plan.limits.reach - self.plan.limits.horizon
        order = np.argsort(gap, kind="stable")
        bounds = np.searchsorted(gap[order], np.arange(1, int(gap.max(initial=0)) + 2))
        for length, (low, high) in enumerate(pairwise(bounds.tolist()), 1):
            here = order[low:high]
            x[here] = x[here - 1] @ F.T
            ready[here] = ready[here - 1]
            if length >= certain:
                for step in here[ready[here]].tolist():
                    ready[step] = self._alone(step) is not None
        x[~ready] = np.nan


def _slice(op: Convolution, z: Array) -> Array:
    """All full windows of a piece."""
    wanted = len(z) - op.history
    padded = np.zeros((op.history + -(-wanted // op.block) * op.block, op.inputs))
    padded[: len(z)] = z
    return np.asarray(convolve(op, padded)[:wanted])


def _transported(F: Array, oldest: Array, ages: NDArray[np.int64]) -> Array:
    """F^age of each column of `oldest` (n, count): (count, n), by the bits of the ages."""
    moved, power = oldest.T.copy(), F
    bit = 0
    while (ages >> bit).any():
        odd = (ages >> bit) & 1 == 1
        moved[odd] = moved[odd] @ power.T
        power, bit = power @ power, bit + 1
    return moved


def present_in(request: Request, series: int) -> Mask:
    """Components of one series that are measured (T, dim_z): not NaN, and seen by H."""
    return np.asarray(~np.isnan(request.z[series]) & request.model.H.any(axis=1))


@lru_cache(maxsize=64)
def hole_plan(plan: SeriesPlan, extends: bool) -> HolePlan:
    """The shared plan for holes of a plan."""
    return HolePlan(plan, extends)
