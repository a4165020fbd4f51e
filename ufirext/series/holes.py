"""A constant model and a series with holes: normal equations in an orthonormal basis, for all steps at once.

With the rows U_i of the basis, x^ = T back Lam^-1 eta, eta = sum_i U_i' z_i and Lam = sum_i U_i' U_i over the
rows that are there. Both are convolutions, of the measurements with zeros in the holes and of the holes
themselves, and Lam is close to the identity: nothing is lost by normal equations. The few windows for which
that does not hold, or which must reach further back, are solved one by one.
"""

from __future__ import annotations

from functools import cached_property, lru_cache

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
from .summed import Summed
from .toeplitz import convolution
from .windows import Mask, Windows

__all__ = ["HolePlan", "Holes", "hole_plan", "present_in"]

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
    def eta(self) -> Summed:
        """From measurements to eta."""
        return Summed(convolution(self.known_basis.raw))

    @cached_property
    def Lam(self) -> Summed:
        """From the mask of components to the upper triangle of Lam."""
        return Summed(convolution(_squares(self.known_basis)))

    @cached_property
    def aim(self) -> Array:
        """From coefficients in the basis to the state that is wanted."""
        plan = self.plan
        moved = np.linalg.matrix_power(plan.model.F, plan.horizon - 1 - plan.lag)
        return np.asarray(moved @ self.known_basis.back)

    @property
    def known_basis(self) -> Basis:
        """The basis, for those who asked `holds` before."""
        if self.basis is None:
            raise RuntimeError("this window has no basis")
        return self.basis

    def gain(self, present: Mask, lag: int) -> Array | None:
        """Gain on the components present, flat, of a window (span, dim_z) up to now; None: not determined."""
        key = np.packbits(present).tobytes() + len(present).to_bytes(8, "little") + lag.to_bytes(8, "little")
        if key not in self._gains:
            if len(self._gains) >= PATTERNS:
                self._gains.clear()
            self._gains[key] = _gain(self.plan.model, present, lag)
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


class Holes(Windows):
    """One series of a constant model with holes; z is (T, dim_z)."""

    def __init__(self, plan: HolePlan, z: Array, present: Mask, missing: str) -> None:
        super().__init__(np.asarray(present.any(axis=1)), plan.limits, plan.plan.lag, missing == "extend")
        self.plan, self.z, self.present = plan, np.where(present, z, 0.0), present
        # Rows of H that see nothing are no holes.
        lost = (present != plan.plan.model.H.any(axis=1)).any(axis=1)
        count = np.concatenate([[0], np.cumsum(lost)])
        self.broken: Mask = count[1:] > count[self.starts]

    def together(self, wanted: Mask, x: Array) -> Mask:
        """By normal equations in bases."""
        begin, sound = self.limits.horizon - 1, np.zeros_like(wanted)
        for start in range(0, len(x), PIECE):
            first, stop = max(start, begin), min(start + PIECE, len(x))
            if wanted[first:stop].any():
                self._full(first, stop, x, sound, wanted)
        self._growing(min(begin, len(x)), x, sound, wanted)
        return sound

    def alone(self, step: int, begin: int, lag: int) -> Array | None:
        """By orthogonal transformations, the gains of recurring patterns remembered."""
        window = slice(begin, step + 1)
        gain = self.plan.gain(self.present[window], lag)
        return None if gain is None else np.asarray(gain @ self.z[window][self.present[window]])

    def moved(self, x: Array, steps: NDArray[np.int64]) -> Array:
        """A step of the constant model."""
        return x @ self.plan.plan.model.F.T

    def _full(self, start: int, stop: int, x: Array, sound: Mask, wanted: Mask) -> None:
        """Windows of the whole length that end in start .. stop - 1."""
        first = start - self.limits.horizon + 1
        eta = _slice(self.plan.eta, self.z[first:stop])
        Lam = _slice(self.plan.Lam, self.present[first:stop].astype(float))
        solution, fine = _solved(eta, Lam)
        chosen = fine & wanted[start:stop]
        x[start:stop][chosen] = (self.plan.aim @ solution[:, chosen]).T
        sound[start:stop] |= chosen

    def _growing(self, stop: int, x: Array, sound: Mask, wanted: Mask) -> None:
        """Windows that begin with the series, by cumulative sums in bases of doubling length."""
        model, low, length = self.plan.plan.model, 0, FIRST_BASIS
        while low < stop:
            high = min(length, stop)
            basis = basis_of(model, length) if wanted[low:high].any() else None
            if basis is not None:
                eta = np.einsum("im,imr->ir", self.z[:high], basis.raw[:high]).cumsum(axis=0)
                Lam = np.einsum("im,imr->ir", self.present[:high], _squares(basis)[:high]).cumsum(axis=0)
                solution, fine = _solved(eta[low:], Lam[low:])
                steps = low + np.flatnonzero(fine & wanted[low:high])
                sound[steps] = True
                steps = steps[steps >= self.lag]
                oldest = basis.back @ solution[:, steps - low]
                x[steps] = _transported(model.F, oldest, steps - self.lag)
            low, length = high, 2 * length


def _solved(eta: Array, Lam: Array) -> tuple[Array, Mask]:
    """Coefficients (n, count) from eta (count, n) and upper triangles (count, n (n + 1) / 2)."""
    count, n = eta.shape
    whole = np.empty((n, n, count))
    rows, columns = np.triu_indices(n)
    whole[rows, columns] = whole[columns, rows] = Lam.T
    return positive_solution(whole, eta.T, WEAK_PIVOT, np.ones((n, count)))


def _slice(summed: Summed, z: Array) -> Array:
    """All full windows of a piece."""
    op = summed.op
    wanted = len(z) - op.history
    length = -(-wanted // op.block) * op.block
    padded, result = np.zeros((op.history + length, op.inputs)), np.empty((length, op.outputs))
    padded[: len(z)] = z
    summed(padded, result)
    return result[:wanted]


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
