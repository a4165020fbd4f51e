"""The two verbs with a hot path: filters whose state object can put work off until somebody looks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from numpy.typing import ArrayLike

from .._arrays import Array
from ._live import Live
from ._state import POSTED, PREDICTED, TURNED, WATCHED
from ._surface import FilterSurface


class HotState(Protocol):
    """What the hot path asks of a state object, besides what every state object does.

    `put` and `read` are set while nothing but z has to be remembered and x can wait until it is read.
    """

    mode: int
    watching: bool
    F: Live
    H: Live
    Q: Live
    put: Callable[[Any], bool] | None
    read: Callable[[], Array] | None
    hot_x: Any
    _x_handed: Array | None
    _x_raw: bytes

    def hand_out_x(self) -> Array:
        """The state, editable; edits count from the next verb on."""

    def coast(self) -> bool:
        """predict() after a predict(), or while model matrices are watched: False, with nothing done, where
        the slow path is needed.
        """

    def drive(self, u: Any, B: Any, x: Array | None = None) -> bool:
        """predict(u) while the model is constant, or after an edit of x: False, with nothing done, where the
        slow path is needed.
        """

    def take(self, z: Any, R: Any = None, delay: int = 0) -> bool:
        """update() where z alone is not all: False, with nothing done, where the slow path is needed."""

    def turn(self, u: Any, B: Any, F: Any, Q: Any) -> bool:
        """predict() while the model changes: likewise."""

    def join(self, z: Any, R: Any, H: Any) -> bool:
        """update() while the model changes: likewise."""


class HotFilter(FilterSurface):
    """filterpy's face with predict() and update() that cost next to nothing while nothing unusual happens.

    The state object's `mode` says whether the hot path holds; x handed out earlier is compared with what it
    was, so that edits made in place are honoured here too.
    """

    @property
    def x(self) -> Array:
        """State estimate, (dim_x, 1) or (dim_x,), in the form it was last assigned; writes are honoured."""
        state: HotState = self._state  # type: ignore[assignment]
        x = state._x_handed
        if x is None:
            if state.mode == POSTED and state.read is not None:
                x = state._x_handed = state.read()
                state._x_raw = x.tobytes()
            elif state.mode == TURNED:
                x = state._x_handed = state.hot_x.copy()
                state._x_raw = x.tobytes()
            else:
                x = state.hand_out_x()
        return x

    @x.setter
    def x(self, value: ArrayLike) -> None:
        self._state.write_x(value)

    def predict(
        self,
        u: ArrayLike | None = None,
        B: ArrayLike | None = None,
        F: ArrayLike | None = None,
        Q: ArrayLike | None = None,
    ) -> None:
        """Advance one step: x <- F x + B u.

        Parameters
        ----------
        u : scalar or array_like, (dim_u,) or (dim_u, 1), optional
            Known input; ignored where there is no B. It is carried inside the window.
        B, F, Q : array_like, optional
            Replace the attribute for this call.

        Raises
        ------
        ValueError
            For wrong shapes or values that are not finite.
        UnobservableWindow
            At the first verb, for a horizon that can never determine the state while a longer one could.
        """
        state: HotState = self._state  # type: ignore[assignment]
        mode = state.mode
        if mode == POSTED and u is None and F is None and Q is None:
            x = state._x_handed
            if x is None or x.tobytes() == state._x_raw or state.drive(None, None, x):
                state._x_handed = None
                state.mode = PREDICTED
                return
        elif mode:
            x = state._x_handed
            if x is None or x.tobytes() == state._x_raw:
                x = None
            if mode >= TURNED:
                if x is None and state.turn(u, B, F, Q):
                    state._x_handed = None
                    return
            elif (
                (F is None or state.F.known(F) is not None)
                and (Q is None or state.Q.known(Q) is not None)
                and ((mode == POSTED or state.coast()) if u is None and x is None else state.drive(u, B, x))
            ):
                state._x_handed = None
                state.mode = PREDICTED
                return
        super().predict(u, B, F, Q)

    def update(
        self, z: ArrayLike | None, R: ArrayLike | None = None, H: ArrayLike | None = None, *, delay: int = 0
    ) -> None:
        """Take a measurement.

        Parameters
        ----------
        z : scalar or array_like, (dim_z,) or (dim_z, 1), or None
            None: nothing came. NaN: this component did not come.
        R, H : array_like, optional
            Replace the attribute for this call; rows are weighted by their R, H may have any number of rows.
        delay : int, optional
            Age of the measurement in steps: z was taken `delay` steps ago and joins the window at its place.

        Raises
        ------
        ValueError
            For wrong shapes, infinite values, an R that is no covariance, a delay that is no count.
        """
        state: HotState = self._state  # type: ignore[assignment]
        mode = state.mode
        if mode == PREDICTED and R is None and H is None and delay == 0 and state._x_handed is None:
            put = state.put
            if put is not None and put(z):
                state.mode = POSTED
                return
        if mode >= TURNED:
            x = state._x_handed
            if delay == 0 and (x is None or x.tobytes() == state._x_raw) and state.join(z, R, H):
                state._x_handed = None
                return
        elif mode and delay.__class__ is int:
            x = state._x_handed
            regular = x is None or x.tobytes() == state._x_raw
            if regular and (H is None or state.H.known(H) is not None) and state.take(z, R, delay):
                state._x_handed = None
                state.mode = WATCHED if state.watching else POSTED
                return
        super().update(z, R, H, delay=delay)
