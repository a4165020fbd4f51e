"""The one opaque object inside every filter: model, estimate, last update; what deepcopy and pickle copy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._arrays import Array, covariance, finite, real
from ..engines.covariance import Covariance
from ..engines.records import measured
from ..errors import ShapeError
from ..model import Model
from ._arguments import input_matrix, input_vector
from ._checks import Check, General, Inputs, Square
from ._checks import Covariance as CovarianceCheck
from ._live import Live
from ._update import Update

# Where a filter stands: on the slow path; on the hot one of constant models after an update() or a predict();
# likewise on that of models which change. WATCHED is POSTED while somebody holds a model matrix.
SLOW, POSTED, PREDICTED, TURNED, TURNING = 0, 1, 2, 3, 4
WATCHED = -1
# Masks of measurements with every component present.
_ALL: dict[int, NDArray[np.bool_]] = {size: np.ones(size, dtype=np.bool_) for size in range(1, 65)}


@lru_cache(maxsize=64)
def _blanks(dim_x: int, dim_z: int) -> tuple[tuple[Array, Check], ...]:
    """F, H, Q, R and M of a new filter, and their checks; trackers make many filters of one kind."""
    return (
        (np.eye(dim_x), Square(dim_x, "F")),
        (np.zeros((dim_z, dim_x)), General((dim_z, dim_x), "H", "(dim_z, dim_x)")),
        (np.eye(dim_x), CovarianceCheck(dim_x, "Q")),
        (np.eye(dim_z), CovarianceCheck(dim_z, "R")),
        (np.zeros((dim_x, dim_z)), General((dim_x, dim_z), "M", "(dim_x, dim_z)")),
    )


@lru_cache(maxsize=128)
def _model(dim_x: int, dim_z: int, F: bytes, H: bytes, Q: bytes, R: bytes) -> Model:
    """The model of these matrices, looked at once."""
    n, m = dim_x, dim_z
    F_now, H_now, Q_now, R_now = (np.frombuffer(raw) for raw in (F, H, Q, R))
    return Model(F_now.reshape(n, n), H_now.reshape(m, n), Q_now.reshape(n, n), R_now.reshape(m, m))


class Touched:
    """What every verb of a hot path touches, in slots, which are quicker to reach than a large __dict__."""

    __slots__ = HOT = ("_x_handed", "_x_raw", "mode", "put", "read")

    mode: int
    put: Callable[[Any], bool] | None  # z into the engine, where nothing else need be done or watched
    read: Callable[[], Array] | None  # x, where it can wait until it is read
    _x_handed: Array | None  # the client's array, while it may be edited
    _x_raw: bytes  # what was in it


class FilterState(Touched):
    """Estimate, covariance and model of a filter, with outside writes noticed and honoured.

    Subclasses say what a filter does: `_advance` (predict), `_absorb` (a measurement), `_skip` (none came),
    `_moved` (x was written from outside), `_model_changed`.
    """

    def __init__(self, dim_x: int, dim_z: int) -> None:
        self.dim_x, self.dim_z = dim_x, dim_z
        self.F, self.H, self.Q, self.R, self.M = (Live(*blank) for blank in _blanks(dim_x, dim_z))
        self.B: Live | None = None
        self.fading = 1.0
        self.form = 2
        self.now = 0
        self.updated = False
        self.x: Array = np.zeros(dim_x)
        self.P = Covariance.of(self.Q.value)  # as for filterpy, the identity
        self.prior = self.post = (self.x, self.P)
        self._last: Update | tuple[Any, ...] | None = None
        self.watching = False  # whether the client may hold model matrices; which, when verbs last looked
        self.watched: tuple[Live, ...] = ()
        self._asked: Array | None = None
        self._whole = False
        self.mode, self.put, self.read = SLOW, None, None
        self._x_handed, self._x_raw = None, b""
        self._P_handed: Array | None = None
        self._P_raw = b""

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {name: getattr(self, name) for name in self.HOT}

    def __setstate__(self, fields: dict[str, Any]) -> None:
        for name, value in fields.items():
            setattr(self, name, value)

    @property
    def last(self) -> Update | None:
        """What the last update() left behind; put together when somebody asks."""
        if isinstance(self._last, tuple):
            self._last = Update(*self._last)
        return self._last

    @last.setter
    def last(self, value: Update | None) -> None:
        self._last = value

    @property
    def plain(self) -> bool:
        """Whether nothing has come yet, and estimates will be least squares over a window of what comes and
        nothing else.
        """
        return False

    # -- what the client sees --------------------------------------------------------------------------------

    def shaped(self, flat: Array) -> Array:
        """A fresh copy in the client's form, (n, 1) or (n,)."""
        return np.array(flat.reshape(-1, 1) if self.form == 2 else flat)

    def hand_out_x(self) -> Array:
        """The state, editable; edits count from the next verb on."""
        if self._x_handed is None:
            self._x_handed = self.shaped(self.x)
            self._x_raw = self._x_handed.tobytes()
        return self._x_handed

    def hand_out(self, name: str) -> Array:
        """A model matrix, editable; edits count from the next verb on."""
        live: Live = getattr(self, name)
        handed = live.hand_out()
        self.watch()
        return handed

    def hand_out_P(self) -> Array:
        """The covariance, editable; edits count from the next verb on."""
        if self._P_handed is None:
            self.leave()
            self._P_handed = self.P.value.copy()
            self._P_raw = self._P_handed.tobytes()
        return self._P_handed

    def write_x(self, value: Any) -> None:
        """x assigned from outside; its form becomes the client's form."""
        self.leave()
        array = real(value, "x")
        n = self.dim_x
        if array.ndim == 0 and n == 1:
            array = array.reshape(1)
        if array.shape not in ((n,), (n, 1)):
            raise ShapeError(f"x must have shape ({n}, 1) or ({n},), got {array.shape}")
        x = finite(array, "x").reshape(n)
        self.form = array.ndim
        self._x_handed = None
        self._move(x)

    def write_P(self, value: Any) -> None:
        """P assigned from outside."""
        self.leave()
        self.P = Covariance.of(covariance(value, self.dim_x, "P", "(dim_x, dim_x)"))
        self._P_handed = None

    def assign(self, name: str, value: Any) -> None:
        """A model matrix assigned from outside."""
        live: Live = getattr(self, name)
        raw = live.check.quick(value)
        if raw != live.raw:
            self.touch()
        if live.assign(value, raw):
            self._model_changed()
        if live.held and live not in self.watched:
            self.watch()

    def assign_B(self, value: Any, dim_u: int) -> None:
        """The input matrix assigned from outside, None for no input."""
        self.touch()
        live: Live | None = None
        if value is not None:
            check = Inputs((self.dim_x, dim_u))
            live = Live(check(value), check)
            live.assign(value)
        self.B = live
        if live is not None and live.handed is not None:
            self.watch()

    def look(self) -> FilterState:
        """The state with every field worked out."""
        return self

    def touch(self) -> None:
        """A model matrix is about to be changed."""
        self.leave()

    def watch(self) -> None:
        """From here on somebody may hold a model matrix, and edit it."""
        self.touch()
        self.watching = True

    def _intact(self) -> bool:
        """Whether nothing that is watched was edited; what nobody holds any more need not be watched."""
        for live in self.watched:
            if not live.intact():
                return False
            if live.handed is None:
                self._watch_all()
        return True

    def _watch_all(self) -> None:
        """Watch everything that somebody may hold."""
        self.watched = tuple(live for live in self._matrices() if live is not None and live.held)
        self.watching = bool(self.watched)

    def _matrices(self) -> tuple[Live | None, ...]:
        """All that may be handed out."""
        return self.F, self.H, self.Q, self.R, self.M, self.B

    def leave(self) -> None:
        """Leave the hot path, if there is one; edits in place may be half done and are not looked at."""

    def settle(self) -> None:
        """Leave the hot path, and honour everything that was edited in place since the last verb."""
        self.leave()
        if self.watching:
            self._settle_matrices()
        handed = self._P_handed
        if handed is not None and handed.tobytes() != self._P_raw:
            self.P = Covariance.of(covariance(handed, self.dim_x, "P", "(dim_x, dim_x)"))
            self._P_raw = handed.tobytes()
        handed = self._x_handed
        if handed is not None and handed.tobytes() != self._x_raw:
            self._move(finite(handed.reshape(self.dim_x).copy(), "x"))
            self._x_raw = handed.tobytes()

    def _settle_matrices(self) -> None:
        self._look_again(*self._matrices())
        self._watch_all()

    def _look_again(self, *matrices: Live | None) -> None:
        for live in matrices:
            if live is not None and live.handed is not None and live.changed() and live is not self.B:
                self._model_changed()

    def _move(self, x: Array) -> None:
        before, self.x = self.x, x
        if x.tobytes() != before.tobytes():
            self._moved(x - before)

    def _publish(self, x: Array, P: Covariance) -> None:
        self.x, self.P = x, P
        self._x_handed = self._P_handed = None

    # -- the two transitions ---------------------------------------------------------------------------------

    def transition(
        self, u: ArrayLike | None, B: ArrayLike | None, F: ArrayLike | None, Q: ArrayLike | None
    ) -> tuple[Array, Array, Array | None]:
        """F, Q and the known change of the state, of predict()'s arguments and the attributes."""
        F_now = self.F.value if F is None else self.F.taken(F)
        Q_now = self.Q.value if Q is None else self.Q.taken(Q)
        known = None
        if u is not None and (B is not None or self.B is not None):
            inputs = self.B.value if B is None and self.B is not None else input_matrix(B, self.dim_x)
            known = inputs @ input_vector(u, inputs.shape[1])
        return F_now, Q_now, known

    def predict(self, F: Array, Q: Array, known: Array | None) -> None:
        """Time update by F, Q and a known change of the state."""
        x = F.dot(self.x)
        self._advance(F, Q, known)
        self._publish(x if known is None else x + known, self.P.predicted(F, Q, self.fading))
        self.now += 1
        self.updated = False
        self.prior = (self.x, self.P)

    def update(
        self, z: Array | None, H: Array, R: Array, delay: int, cross: Array | None = None, whole: bool = False
    ) -> None:
        """Measurement update; z flat with NaN for missing components, or None; `whole`: every component is
        there.
        """
        x, P = self.x, self.P
        gain: Covariance | None = None
        mask: NDArray[np.bool_] = _ALL[len(H)] if whole else np.zeros(len(H), dtype=np.bool_)
        if whole and z is not None:
            gain = self._absorb(z, H, R, delay, cross)
        elif z is not None:
            z_in, H_in, R_in, mask = measured(z, H, R)
            if len(z_in):
                gain = self._absorb(z_in, H_in, R_in, delay, cross)
        if gain is None:
            self._skip()
            gain = Covariance.of(np.zeros((self.dim_x, int(mask.sum()))))
        self._last = (z, H, R, mask, x, P, gain, cross)
        self.updated = True
        self.post = (self.x, self.P)
        self.warm()

    def sees_all(self, H: Array) -> bool:
        """Whether every row of H measures something; remembered for the last H asked about."""
        if self._asked is not H:
            self._asked, self._whole = H, all(map(any, H.tolist())) and len(H) in _ALL
        return self._whole

    def warm(self) -> None:
        """The end of an update(): a chance to prepare for the next ones."""

    def model(self) -> Model:
        """The model as it stands, as a value."""
        return _model(self.dim_x, self.dim_z, self.F.raw, self.H.raw, self.Q.raw, self.R.raw)

    def keep_P(self, P: Covariance, last: Update | None = None) -> None:
        """Undo the covariance part of the last verb (filterpy's steady-state verbs); `last` lends K and S."""
        self.settle()
        self.P, self._P_handed = P, None
        if self.updated:
            self.post = (self.x, P)
            if self.last is not None and last is not None and len(self.last.H) == len(last.H):
                kept = replace(self.last)
                # Whatever was missing then or is now: K and S are what was published.
                kept.__dict__.update(K=last.K, S=last.S)
                self.last = kept
        else:
            self.prior = (self.x, P)

    def show_earlier(self, z: Array | None) -> None:
        """Fill the published z with the components earlier partial updates of this step brought."""
        last = self.last
        if last is not None and last.z is not None and z is not None and z.shape == last.z.shape:
            self.last = replace(last, z=np.where(last.mask, last.z, z))

    # -- what a kind of filter does --------------------------------------------------------------------------

    def _advance(self, F: Array, Q: Array, known: Array | None) -> None:
        """A predict() is about to happen."""

    def _absorb(self, z: Array, H: Array, R: Array, delay: int, cross: Array | None) -> Covariance | None:
        """Take the measured components and publish; the gain on them, None where the row counts as
        missing.
        """
        raise NotImplementedError

    def _skip(self) -> None:
        """An update() brought nothing: x and P stay the prior."""

    def _moved(self, delta: Array) -> None:
        """x was moved from outside by delta."""

    def _model_changed(self) -> None:
        """A model matrix got another value."""
