"""What a UFIRFilter of a constant model knows while its work waits: the estimate, and what follows from it.

Where the window has holes, late or weighted rows, every estimate that a row met is kept (`Point`); where it
is full, one product gives x. `look` makes every field what the slow path would have made it.
"""

from __future__ import annotations

import numpy as np

from .._arrays import Array
from ..engines.covariance import Covariance
from ..engines.driven import Driven
from ..engines.lean import Hands
from ..engines.records import Solution
from ..engines.ring import Ring
from ..engines.uneven import Point, Uneven, uneven
from ._state import PREDICTED, SLOW
from ._varying_state import VaryingState

# Steps on the hot path that are worth while, where entering and leaving it costs something; the longest wait
# for the next try.
BRIEF, LONGEST_REST = 4, 64


class RingState(VaryingState):
    """A window state whose ring may be ahead of what is published."""

    def __init__(self, dim_x: int, dim_z: int, horizon: int | str, missing: str, window: str) -> None:
        super().__init__(dim_x, dim_z, horizon, missing, window)
        self.ring: Ring | None = None  # the engine, while the hot path holds
        self.plainly: Hands | None = None  # on a ring without inputs
        self.driven: Driven | None = None  # on one with inputs
        self.plain_from = 0  # step since which there is a `read`
        self.uneven: Uneven | None = None  # the ring as it is used where there is none
        self.point: Point | None = None  # then: the last estimate
        self.opened: Point | None = None  # what the last update()'s step started from; None: `prior` tells
        self.faced: Point | None = None  # what its row met
        self.came: int | None = None  # the age of its row, None where nothing came
        # A driven window is left after `entered`, and entered again from `resume` on, the later the shorter
        # it lasted: who looks at everything at every step had better have it worked out at once.
        self.entered = self.rest = self.resume = 0
        self.missed = 0  # hot steps without a measurement, in a row
        self.silent = 0  # of these, the last ones that had no update() either

    def _ring(self, now: int) -> Ring:
        self.put = self.intake = self.plainly = self.driven = self.uneven = None
        return super()._ring(now)

    def _hot_ring(self) -> Ring:
        ring = self.engine
        if not isinstance(ring, Ring):
            raise RuntimeError("the hot path runs on a ring only")
        return ring

    @property
    def ready(self) -> bool:
        """Whether the rows the window reaches determine the state."""
        if self.lane is None and self.mode and self._stand() is None:
            self.leave()
        return self.mode != SLOW or super().ready

    def _stand(self) -> Point | None:
        """The estimate as it stands, which the next row meets; None where it takes the slow path."""
        if self.read is not None:
            ring, x = self._hot_ring(), self.read()
            length = ring.limits.horizon
            self.point = (x, Solution(x.reshape(-1), *ring.plan.lasting(length), length), ring.now, 0)
        elif self.hot_x is None and self._fetch() is None:
            return None
        return self.point

    def _fetch(self) -> Array | None:
        """The estimate where it has been put off."""
        point = (self.uneven or self._hands()).estimate()
        if point is not None:
            self.point, self.hot_x = point, point[0]
        return self.hot_x

    def posted_x(self) -> Array | None:
        """x after the last hot update, in the client's form; None where it takes the slow path."""
        if self.read is not None:
            return self.read()
        return self._fetch() if self.hot_x is None else self.hot_x

    def _hands(self) -> Uneven:
        if self.uneven is None:
            self.uneven = uneven(self._hot_ring(), self.form == 2)
        return self.uneven

    def _one_ahead(self, x: Array) -> Array:
        ring = self._hot_ring()
        ahead: Array = self.F.value.dot(x)
        known = ring.known_at(ring.now + 1)
        if known is None:
            return ahead
        return ahead + known if x.ndim == 1 else ahead + known.reshape(-1, 1)

    def hand_out_x(self) -> Array:
        """The state, editable; edits count from the next verb on."""
        if self._x_handed is None and self.mode:
            if self.lane is not None:
                handed = self._x_handed = self.turned_x()
                self._x_raw = handed.tobytes()
                return handed
            x = self.posted_x()
            if x is not None:
                if self.mode == PREDICTED:
                    x = self._one_ahead(x)
                elif self.read is None:
                    x = x.copy()
                self._x_handed, self._x_raw = x, x.tobytes()
                return x
            self.leave()
        return super().hand_out_x()

    # -- what the verbs left out -----------------------------------------------------------------------------

    def look(self) -> RingState:
        """Work out what the hot path left out; every field is then what the slow path would have made it."""
        if not self.mode:
            return self
        if self.lane is not None:
            self._publish_turned(self.lane)
            return self
        ring = self._hot_ring()
        if ring.inputs is not None and self.driven is not None:
            self.driven.sync()
        now = ring.now - self.silent  # the step of the last update()
        if now != self.seen:
            self._catch_up(ring, now)
        self.x, self.P = self.post
        for step in range(now + 1, ring.now + (self.mode == PREDICTED) + 1):
            self.x, self.P = self.prior = self._predicted(self.x, self.P, step)
        if self._x_handed is not None:
            self.x = np.frombuffer(self._x_raw).copy()  # to the bit what the client was given
        if self.solution is None:
            self._cool()
        return self

    def _catch_up(self, ring: Ring, now: int) -> None:
        """The last update(), as the slow path would have published it."""
        if self.read is not None:
            self._face_plainly(ring)
        opened, faced, came = self.opened, self.faced, self.came
        if faced is None or self.point is None:
            raise RuntimeError("a hot row meets an estimate")
        if opened is not None:
            self.prior = self._carried(opened, now)
        before = self.prior if faced is opened else self._carried(faced, now)
        self.now, (self.x, self.P) = now, before
        z, R, handed = None, self.R.value, self._x_handed
        if came is None:
            gain = Covariance.of(np.zeros((self.dim_x, 0)))
            self.solution, self.ready_at = self._solved(self.point), self.point[2]
        else:
            row = ring.row(now - came)
            z, R = row.z, row.R if now - came in ring.weighted else R
            found = None if self.read is not None else self._stand()
            self.ready_at = faced[2]
            gain = self._concluded(self._solved(found) if found else ring.solve(), z, row.H, R, came)
        self.post, self._x_handed = (self.x, self.P), handed
        self._last = (z, self.H.value, R, np.full(self.dim_z, came is not None), *before, gain, None)
        self.updated, self.seen = True, now

    def _face_plainly(self, ring: Ring) -> None:
        """What the last row met, where it was a plain one of many."""
        self.came = 0
        if ring.now > self.plain_from:
            earlier = ring.solve_at(ring.now - 1)
            self.opened = self.faced = (earlier.x, earlier, ring.now - 1, 0)

    def _solved(self, point: Point) -> Solution:
        x, known, _, age = point
        if isinstance(known, Solution):
            return known
        rows = int(np.count_nonzero(np.frombuffer(known)))
        return self._hot_ring().solution(x.reshape(-1), known, rows, age)

    def _carried(self, point: Point, now: int) -> tuple[Array, Covariance]:
        """x and P of an estimate, predicted up to a step."""
        solution = self._solved(point)
        x, P = solution.x, solution.covariance
        for step in range(point[2] + 1, now + 1):
            x, P = self._predicted(x, P, step)
        return x, P

    def _predicted(self, x: Array, P: Covariance, step: int) -> tuple[Array, Covariance]:
        ahead, known = self.F.value @ x, self._hot_ring().known_at(step)
        P = P.predicted(self.F.value, self.Q.value, self.fading)
        return ahead if known is None else ahead + known, P

    def leave(self) -> None:
        """Leave the hot path."""
        if self.lane is not None:
            self.look()
            self._leave_lane(self.lane)
        elif self.mode:
            self.look()
        if self.mode:
            self._cool()

    def _cool(self) -> None:
        if self.ring is not None and self.ring.inputs is not None:
            now = self.ring.now
            self.rest = 0 if now - self.entered >= BRIEF else min(2 * self.rest + 1, LONGEST_REST)
            self.resume = now + self.rest
        if self.mode == PREDICTED:
            ring = self._hot_ring()
            ring.advance(ring.take_coming())
            self.now += 1 + self.silent
            self.updated = False
        self.mode, self.silent, self.ring, self.read, self.put = SLOW, 0, None, None, None
        self.point = self.opened = self.faced = self.hot_x = None
