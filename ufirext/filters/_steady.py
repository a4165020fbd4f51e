"""The hot path of filters with a gain that settles: nothing but x moves once the covariances stand still."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from .._arrays import Array, readings
from ..engines.covariance import Covariance
from ._state import FilterState

# SLOW: every verb does all its work. Else the covariances stand still: predict() only moves `mode` from
# POSTED to PREDICTED, update() only moves x, and everything published is worked out when it is looked at.
SLOW, POSTED, PREDICTED = 0, 1, 2
# The covariances stand still when all the steps to come cannot move them by more than this, relative.
STILL = 1e-12
# They are looked at every so many steps.
INTERVAL = 8


class Steady(NamedTuple):
    """A step that repeats: its matrices, its gain, and what the filter holds beside x after each verb."""

    F: Array
    H: Array
    R: Array
    A: Array
    K: Array
    prior: Covariance
    post: Covariance
    gain: Covariance
    before: Any
    after: Any


class SteadyState(FilterState):
    """A filter whose covariances may come to a standstill.

    Subclasses say what they hold beside x (`_held`, `_resume`), which of it must stand still (`_levels`), and
    whether a step is one that can repeat (`_repeats`).
    """

    def __init__(self, dim_x: int, dim_z: int) -> None:
        super().__init__(dim_x, dim_z)
        self.steady: Steady | None = None
        self.base = self.met = self.x  # estimate before the open step, and before the last update's step
        self.met_z: Array | None = None
        self.looked = True
        self.hot = 0  # hot predictions since everything was last worked out
        self.regular = False
        self.before: Any = None
        self.levels: tuple[int, list[Array]] | None = None

    # -- the hot verbs --------------------------------------------------------------------

    def hot_predict(self) -> bool:
        """Predict by moving `mode` alone; False if that is not possible."""
        if not self._unedited():
            return False
        self.base = self.x
        self.mode = PREDICTED
        self.looked = False
        self.now += 1
        self.hot += 1
        return True

    def hot_update(self, z: Any) -> bool:
        """Update by moving x alone; False if that is not possible."""
        steady = self.steady
        if steady is None or not self._unedited():
            return False
        if z.__class__ is not np.ndarray or z.dtype != float:
            if z is None:
                return False
            z = readings(z, "z")
        if z.size != len(steady.H) or (z.ndim == 2 and 1 not in z.shape) or z.ndim > 2:
            return False
        flat = z.ravel()
        if not flat.dot(flat) < np.inf:
            return False
        self.x = steady.A.dot(self.base) + steady.K.dot(flat)
        # The client may write to its array later.
        self.met, self.met_z = self.base, flat.copy()
        self.mode = POSTED
        self.looked = False
        return True

    def _unedited(self) -> bool:
        """Neither the model nor x nor P was written since it was handed out; x and P are handed out anew from
        now on.
        """
        if self.watching and not self._intact():
            return False
        handed = self._x_handed
        if handed is not None:
            if handed.tobytes() != self._x_raw:
                return False
            self._x_handed = None
        handed = self._P_handed
        if handed is not None:
            if handed.tobytes() != self._P_raw:
                return False
            self._P_handed = None
        return True

    # -- looking --------------------------------------------------------------------------

    def look(self) -> FilterState:
        """The state with every field worked out."""
        steady = self.steady
        if self.looked or steady is None:
            return self
        self.looked = True
        if self.mode == PREDICTED:
            self.x = steady.F.dot(self.base)
            self.prior, self.post = (self.x, steady.prior), (self.base, steady.post)
        else:
            self.prior, self.post = (steady.F.dot(self.base), steady.prior), (self.x, steady.post)
        self.updated = self.mode == POSTED
        self.P = steady.post if self.updated else steady.prior
        if self.met_z is not None:
            met = steady.F.dot(self.met)
            mask = np.ones(len(steady.H), dtype=bool)
            self._last = (self.met_z, steady.H, steady.R, mask, met, steady.prior, steady.gain, None)
            self.met_z = None
        self._resume(steady.after if self.updated else steady.before, self.hot)
        self.hot = 0
        return self

    def leave(self) -> None:
        """From here on every verb does all its work again."""
        if self.mode:
            self.look()
            self.mode = SLOW

    def hand_out_x(self) -> Array:
        """The state, editable; edits count from the next verb on."""
        if self.mode == PREDICTED:
            self.look()
        return super().hand_out_x()

    def hand_out_P(self) -> Array:
        """The covariance, editable; looking at it does not end the hot path."""
        if self._P_handed is None and self.mode and not self.watching:
            self.look()
            self._P_handed = self.P.value.copy()
            self._P_raw = self._P_handed.tobytes()
        return super().hand_out_P()

    def _model_changed(self) -> None:
        self.look()
        self.mode, self.steady, self.levels = SLOW, None, None

    # -- entering -------------------------------------------------------------------------

    def _predicted(self, F: Array, Q: Array) -> None:
        """A predict() by F and Q that did all its work has ended; note whether its like may follow."""
        own = F is self.F.value and Q is self.Q.value
        self.regular = own and self.fading == 1.0 and self._repeats()
        if self.regular:
            self.before = self._held()

    def _enter(self, H: Array, R: Array, gain: Covariance) -> None:
        """A whole measurement on time was the first of its step: the hot path, if the last was the same."""
        if not self.regular or H is not self.H.value or R is not self.R.value:
            self.levels = None
            return
        if self.now % INTERVAL == INTERVAL - 1:
            self.levels = (self.now, self._levels())
        elif self.levels is not None and self.levels[0] == self.now - 1:
            A = self.F.value - gain.value @ (H @ self.F.value)
            if _stands_still(self.levels[1], self._levels(), A):
                prior, post = self.prior[1], self.P
                K = np.ascontiguousarray(gain.value)
                self.steady = Steady(self.F.value, H, R, A, K, prior, post, gain, self.before, self._held())
                self.mode, self.looked, self.hot, self.met_z = POSTED, True, 0, None

    # -- what a kind of filter says -------------------------------------------------------

    def _held(self) -> Any:
        """Everything held beside x, as immutable values."""
        return None

    def _resume(self, held: Any, steps: int) -> None:
        """Hold this again, `steps` steps later; x and P are set."""

    def _levels(self) -> list[Array]:
        """Symmetric and other matrices that must stand still, the covariance first."""
        return [self.P.value]

    def _repeats(self) -> bool:
        """Whether a step can be like the one before."""
        return True


def _stands_still(old: list[Array], new: list[Array], A: Array) -> bool:
    """What changed in a step, and the geometric series of all changes to come, is below STILL."""
    if len(old) != len(new):
        return False
    width = np.sqrt(np.diag(new[0]))
    if not width.all():
        return False
    spread = width[:, None] * width
    change = max(
        float(np.abs((b - a) / spread[: len(b), : b.shape[1]]).max()) for a, b in zip(old, new, strict=True)
    )
    if change > STILL:
        return False
    rate = float(np.abs(np.linalg.eigvals(A)).max())
    return rate < 1.0 and change <= STILL * (1.0 - rate * rate)
