"""Everything a constant model and a horizon determine beforehand, computed when first needed and shared."""

from __future__ import annotations

from functools import cached_property, lru_cache

import numpy as np

from .._arrays import Array, readonly
from ..errors import UnobservableWindow
from ..gains import Gain, exact_covariance, least_squares, observability_index, ufir_gain
from ..model import Model
from ..window import Window, whitener
from .basis import Basis, Memory
from .covariance import Covariance

# Patterns of holes remembered by a plan, bytes of their keys.
PATTERN_BYTES = 500_000
# Numbers in the gain of a driven model beyond which steps one by one are as quick, and what rounding may
# leave of its D_0, relative to the largest D.
LARGEST, EXACT = 40_000, 1e-12


class Plan:
    """Gains of a constant model: full windows of every length up to the horizon, and bases for windows
    with holes.
    """

    def __init__(self, model: Model, horizon: int) -> None:
        self.model, self.horizon = model, horizon
        self.index = observability_index(model)
        self.whitener = readonly(whitener(model.R))
        self._gains: dict[int, Gain | None] = {}
        self._lasting: dict[int, tuple[Covariance, Covariance, Covariance]] = {}
        self._bases: dict[int, Basis] = {}
        self._memories: dict[tuple[int, int, int], Memory] = {}
        self._patterns: dict[bytes, Pattern] = {}

    def __reduce__(self) -> tuple[object, ...]:
        return (plan, (self.model, self.horizon))

    def gain(self, length: int) -> Array | None:
        """Gain on the full window of `length` steps, None where it does not determine the state."""
        if length not in self._gains:
            try:
                self._gains[length] = ufir_gain(self.model, length)
            except UnobservableWindow:
                self._gains[length] = None
        gain = self._gains[length]
        return None if gain is None else gain.K

    @cached_property
    def driven(self) -> Array | None:
        """[G_0 D_0 G_1 D_1 ..], the gain on the rows z_i and the known changes k_i of x in the full window.

        D follows from z_i = H x_i + v_i and x_i = F x_{i-1} + k_i + w_i, backwards from the newest step:
        D_{N-1} = I - G_{N-1} H, D_i = D_{i+1} F - G_i H, down to D_0 = 0, which is what makes G unbiased.
        None where digits were lost on the way, or where steps one by one are as quick as the product.
        """
        gain, F, H = self.gain(self.horizon), self.model.F, self.model.H
        m, n = H.shape
        if gain is None or self.horizon * n * (m + n) > LARGEST:
            return None
        both = np.zeros((n, self.horizon, m + n))
        both[:, :, :m] = gain.reshape(n, self.horizon, m)
        D = np.eye(n)
        for i in range(self.horizon - 1, -1, -1):
            D = both[:, i, m:] = D - both[:, i, :m] @ H
            D = D @ F if i else D
        if not float(np.abs(D).max()) <= EXACT * float(np.abs(both[:, :, m:]).max()):
            return None
        both[:, 0, m:] = 0.0
        return readonly(both.reshape(n, -1))

    def lasting(self, length: int) -> tuple[Covariance, Covariance, Covariance]:
        """What full windows of `length` steps share: exact covariance, gain, gain on the newest row."""
        if length not in self._lasting:
            gain = self.gain(length)
            if gain is None:
                raise UnobservableWindow(f"a window of {length} steps does not determine the state")
            newest = gain[:, -self.model.dim_z :]
            self._lasting[length] = (
                Covariance(_covariance, (self, length)),
                Covariance.of(gain),
                Covariance.of(newest),
            )
        return self._lasting[length]

    def basis(self, length: int) -> Basis:
        """Basis of the full window of `length` steps."""
        if length not in self._bases:
            self._bases[length] = Basis(self.model, length)
        return self._bases[length]

    def memory(self, length: int, least: int, spread: int) -> Memory:
        """Gains of windows of `length` steps with holes, `least` rows or more, and delays up to `spread`."""
        key = (length, least, spread)
        if key not in self._memories:
            self._memories[key] = Memory(self.basis(length), least, spread)
        return self._memories[key]

    def pattern(self, weights: bytes) -> Pattern:
        """Gain and covariance of a window with holes and weighted rows, remembered: patterns recur as they
        slide.
        """
        found = self._patterns.get(weights)
        if found is None:
            if len(self._patterns) * len(weights) >= PATTERN_BYTES:
                self._patterns.clear()
            found = self._patterns[weights] = Pattern(self, np.frombuffer(weights))
        return found


class Pattern:
    """A window of a constant model in which step i of the last len(weights) has a row of weight
    weights[i], or none.
    """

    def __init__(self, plan: Plan, weights: Array) -> None:
        model = plan.model
        self.weights = weights
        present = np.flatnonzero(weights)
        self.ages = len(weights) - 1 - present
        self.rows = len(present)
        span = int(self.ages[0]) if self.rows else 0
        roots = np.sqrt(weights[present])
        self.window = Window(
            F=[model.F] * span,
            Q=[model.Q] * span,
            H=[model.H] * self.rows,
            R=[model.R / weight for weight in weights[present]],
            origins=(span - self.ages).tolist(),
            aim=span,
            whiteners=[plan.whitener * root for root in roots],
        )

    @cached_property
    def determined(self) -> bool:
        """Whether the rows determine the newest state."""
        return self.rows > 0 and self.window.determined()

    @cached_property
    def gain(self) -> Array:
        """Gain on the raw rows present, oldest first."""
        return readonly(least_squares(self.window))

    @cached_property
    def weighted_gain(self) -> Array:
        """The gain on weighted measurements w z in all slots, zero where there is no row."""
        m = self.window.H[0].shape[0] if self.rows else 1
        full = np.zeros((self.gain.shape[0], len(self.weights), m))
        present = np.flatnonzero(self.weights)
        full[:, present] = self.gain.reshape(-1, self.rows, m) / self.weights[present, None]
        return np.ascontiguousarray(full.reshape(len(full), -1))

    @cached_property
    def covariance(self) -> Array:
        """Its exact error covariance."""
        return readonly(exact_covariance(self.window, self.gain))

    def gain_at(self, age: int) -> Array:
        """Columns of the gain for the row `age` steps old."""
        place = int(np.flatnonzero(self.ages == age)[0])
        m = self.window.H[0].shape[0]
        return self.gain[:, place * m : (place + 1) * m]


def _covariance(plan: Plan, length: int) -> Array:
    return ufir_gain(plan.model, length).P


@lru_cache(maxsize=128)
def plan(model: Model, horizon: int) -> Plan:
    """The shared plan of a model and a horizon; trackers make many filters of one model."""
    return Plan(model, horizon)
