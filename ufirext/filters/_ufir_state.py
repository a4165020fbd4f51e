"""The hot path of a UFIRFilter: work that waits until somebody looks.

On a constant model predict() only moves `mode` from POSTED to PREDICTED, and notes a known input or an edit
of x; update() stores z, and x is worked out when it is read, or when the next row needs it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .._arrays import FLOAT, Array, finite
from ..engines.driven import Driven, drivable
from ..engines.lean import intake, reading
from ..engines.ring import Ring
from ..engines.uneven import REGULAR
from ..engines.varying import Varying
from ._arguments import input_vector
from ._ring_state import RingState
from ._state import POSTED, PREDICTED, SLOW, WATCHED
from ._window_state import MISSING, WINDOWS, checked_horizon

__all__ = ["MISSING", "POSTED", "PREDICTED", "SLOW", "WINDOWS", "UFIRState", "checked_horizon"]

# What belongs to one filter and is made anew for a copy.
TORN = ("put", "intake", "plainly", "driven", "uneven")


class UFIRState(RingState):
    """A window state with a hot path for constant models as well."""

    def warm(self) -> None:
        """Go over to the hot path if nothing stands against it."""
        ring, solution = self.engine, self.solution
        if self.ready_at != self.now or self.missing != "extend" or self._P_handed is not None:
            return
        if isinstance(ring, Varying):
            self._enter(ring)
        elif (
            isinstance(ring, Ring)
            and (ring.inputs is None or (ring.now >= self.resume and drivable(ring)))
            and ring.ordinary
            and solution is not None
            and not (self.stale and self.policy == "auto")
            and self._anchored()
        ):
            self.mode = WATCHED if self.watching else POSTED
            self.seen, self.ring, self.missed, self.silent = ring.now, ring, 0, 0
            self.entered = ring.now
            if self.uneven is not None and self.uneven.column != (self.form == 2):
                self.uneven = None
            self.hot_x = self.shaped(self.x)
            self.point, self.opened = (self.hot_x, solution, ring.now, 0), None
            self._read_plainly(ring)

    def _read_plainly(self, ring: Ring) -> None:
        """From here on x is one product, if the window is full and without holes."""
        self.read = self.put = None
        gain = ring.plan.gain(ring.limits.horizon) if ring.full else None
        if gain is None:
            return
        if ring.inputs is not None:
            if self.driven is None or self.driven.inputs is not ring.inputs:
                self.driven = Driven(ring, ring.inputs)
            self.driven.enter()
            self.intake, readers = self.driven.hands
        elif ring.raw is None:
            if self.plainly is None:
                self.plainly = intake(ring), (reading(ring, gain, False), reading(ring, gain, True))
            self.intake, readers = self.plainly
        else:
            return
        self.read, self.plain_from, self.hot_x = readers[self.form == 2], ring.now, None
        self._choose_put()

    # -- the verbs -------------------------------------------------------------------------------------------

    def take(self, z: Any, R: Any = None, delay: int = 0) -> bool:
        """The hot path's update() where z alone is not all; False, with nothing done, where the slow path is
        needed.
        """
        if self.watching and not self._intact():
            return False
        opens = self.mode == PREDICTED
        if z is None:
            return opens and R is None and not delay and self._miss(updates=True)
        plainly = self.read is not None and opens and not delay
        if plainly and self.intake is not None and (R is None or self.R.known(R) is not None):
            return self.intake(z)
        if self._hot_ring().inputs is not None:
            return False
        point = self._stand() if self.hot_x is None else self.point
        laid = point is not None and (self.uneven or self._hands()).lay(z, delay, R, opens)
        if not laid:
            return False
        if opens:
            self.opened = point
        self.faced, self.came, self.hot_x, self.read, self.put = point, delay, None, None, None
        self.missed = self.silent = 0
        self.seen = -1
        if laid == REGULAR:
            self._read_plainly(self._hot_ring())
        return True

    def coast(self) -> bool:
        """The hot path's predict() after a predict(), or while somebody holds a model matrix."""
        return self._intact() and (self.mode == WATCHED or self._miss(updates=False))

    def _miss(self, updates: bool) -> bool:
        ring = self._hot_ring()
        patient = self.missed < ring.limits.horizon and ring.inputs is None
        point = self._stand() if patient else None
        if point is None:
            return False
        self.hot_x = self.F.value.dot(point[0] if self.hot_x is None else self.hot_x)
        if self.read is not None:
            self._face_plainly(ring)
            self.read = self.put = None
        self._hands().step(True)
        self.missed += 1
        if updates:
            self.opened = self.faced = point
            self.came, self.silent, self.seen = None, 0, -1
        else:
            self.silent += 1
        return True

    def drive(self, u: Any, B: Any, x: Array | None = None) -> bool:
        """The hot path's predict() with a known input, or after an edit of x; False, with nothing done, where
        the slow path is needed.
        """
        if self.mode == PREDICTED or (self.watching and not self._intact()):
            return False
        if self.B is None:
            if u is not None and B is not None:
                return False
            u = None  # as in filterpy, inputs go nowhere
        elif u is not None and B is not None and self.B.known(B) is None:
            return False
        driven = self.driven if self._hot_ring().inputs is not None else None
        delta = None
        if x is not None:
            delta = x.reshape(-1) - np.frombuffer(self._x_raw)
            if driven is None or not delta.dot(delta) < np.inf:
                return False
        if u is not None and self.B is not None:
            B = self.B.value
            if driven is None:
                return not B.dot(input_vector(u, B.shape[1])).any()
            driven.push(B, u) or driven.push(B, input_vector(u, B.shape[1]))
        if driven is not None and delta is not None:
            driven.nudge(delta)
        return True

    def write_x(self, value: Any) -> None:
        """x assigned from outside; where a driven window goes on, this is an edit like one in place."""
        plainly = (
            self.mode in (POSTED, WATCHED) and self.read is not None and self._hot_ring().inputs is not None
        )
        shape = (self.dim_x, 1) if self.form == 2 else (self.dim_x,)
        if plainly and value.__class__ is np.ndarray and value.dtype is FLOAT and value.shape == shape:
            finite(value, "x")
            self.hand_out_x()
            self._x_handed = value.copy()
        else:
            super().write_x(value)

    # -- copies ----------------------------------------------------------------------------------------------

    def _detach(self) -> None:
        """Work out the covariances that still lean on an engine which is about to have a life of its own."""
        if isinstance(self.engine, Varying):
            for P in (self.P, self.prior[1], self.post[1]):
                P.value  # noqa: B018
            if self.solution is not None:
                self.solution.gain.value, self.solution.newest_gain.value  # noqa: B018
            if self.last is not None:
                self.last.P.value, self.last.gain.value  # noqa: B018

    def __deepcopy__(self, memo: dict[int, Any]) -> UFIRState:
        self.settle()
        self._detach()
        return self._forked(TORN)

    def __getstate__(self) -> dict[str, Any]:
        self.settle()
        self._detach()
        return super().__getstate__() | dict.fromkeys((*TORN, "_x_handed", "_P_handed"))
