"""horizon="adaptive": candidates side by side on the same rows, the one that foretells best is published."""

from __future__ import annotations

import copy
from collections import deque
from typing import Any

import numpy as np

from .._arrays import Array
from ..adaptive import HorizonBank, bank_candidates
from ..engines.covariance import Covariance
from ..engines.records import Records
from ..engines.varying import Varying
from ..gains import observability_index
from ..window import whitener
from ._checks import Check
from ._live import Live
from ._state import FilterState
from ._ufir_state import POSTED, PREDICTED, UFIRState

MODEL = ("F", "H", "Q", "R")
# What an AdaptiveState holds beside what every UFIRState does.
OWN = ("bank", "members", "current", "X", "stood", "foretold", "errors", "past", "fed", "white")


class Member(UFIRState):
    """One candidate: a UFIR filter of a fixed horizon whose model, warm-up and prior are its owner's."""

    def __init__(self, owner: AdaptiveState, horizon: int, past: Records | None) -> None:
        window = "arrivals" if owner.by_arrival else "origins"
        super().__init__(owner.dim_x, owner.dim_z, horizon, owner.missing, window)
        self.form = 1
        self.now, self.updated, self.x = owner.now, owner.updated, owner.x
        self.irregular = owner.now
        self.taken = False  # whether the last row went into the window
        self.follow(owner)
        if past is not None:
            self.engine = self._over(past.copy())
            self.solution = past.solve(self.limits)

    def follow(self, owner: AdaptiveState) -> None:
        """Take over the owner's model: the very same arrays, by which what is constant is recognised."""
        self.settle()
        for name in MODEL:
            setattr(self, name, Live(value := getattr(owner, name).value, Check(value.shape)))
        self.index, self.refreshed, self.stale = owner.index, owner.now, False

    def step(self, F: Array, Q: Array, known: Array | None) -> None:
        """predict(), on the hot path where it can be."""
        if self.mode == POSTED and known is None and F is self.F.value and Q is self.Q.value:
            self.mode = PREDICTED
            return
        self.settle()
        self.predict(F, Q, known)

    def feed(self, z: Array | None, H: Array, R: Array, delay: int) -> None:
        """update() with measured components, on the hot path where it can be."""
        usual = self.mode == PREDICTED and delay == 0 and H is self.H.value and R is self.R.value
        if usual and self.take(z):
            self.mode, self.taken = POSTED, z is not None
            if self.posted_x() is None:
                self.leave()
            return
        self.taken = False
        self.settle()
        self.update(z, H, R, delay, whole=z is not None)

    def edit(self, delta: Array) -> None:
        """The owner's x was moved by `delta`."""
        self.settle()
        self.x = self.x + delta
        self._moved(delta)

    @property
    def fresh(self) -> bool:
        """Whether the window has spoken in this step."""
        return bool(self.mode) or self.ready_at == self.now

    def estimate(self) -> Array:
        """x after the last update, without working out anything else."""
        x = self.posted_x() if self.mode else None
        return self.x if x is None else x

    def _enter(self, engine: Varying) -> None:
        """Arguments come to a member checked and copied: nothing is left to be saved."""

    def fork(self) -> Member:
        """An independent copy."""
        twin = copy.copy(self)
        twin.engine = None if self.engine is None else self.engine.copy()
        return twin

    def _absorb(self, z: Array, H: Array, R: Array, delay: int, cross: Array | None) -> Covariance | None:
        gain = super()._absorb(z, H, R, delay, cross)
        self.taken = gain is not None
        return gain

    def _kalman(self, z: Array, H: Array, R: Array, cross: Array | None) -> Covariance:
        # Warm-up is the owner's: one Kalman filter for all candidates.
        return Covariance.of(np.zeros((self.dim_x, len(z))))


class AdaptiveState(UFIRState):
    """A bank of candidates that see the same rows; x, P and all that is published are the best one's.

    Candidates are judged by how well they foretell the rows: z against H F x^_{n-1} + known inputs, a late
    row against H x^ as it stood at its origin. The rows of a step are judged together and count from the next
    step on: x is linear in the newest row, and rows may come in any order. The rows of `X` are the estimates
    of all candidates, NaN where a window does not determine the state.
    """

    def __init__(self, dim_x: int, dim_z: int, missing: str, window: str) -> None:
        super().__init__(dim_x, dim_z, "adaptive", missing, window)
        self._empty()

    def _empty(self) -> None:
        self.bank: HorizonBank | None = None
        self.members: list[Member] = []
        self.current = 0  # the member whose estimate is published
        self.X = self.stood = np.zeros((0, self.dim_x))  # now, and as the rows of this step see it
        self.foretold = self.X  # before the rows of this step
        self.errors: Array | None = None  # of the rows of this step
        self.past: deque[Array] = deque()  # `stood` of earlier steps, newest last
        self.fed = 0  # step of the last row
        self.white: tuple[Array, Array] | None = None  # R and its whitener

    @classmethod
    def of(cls, state: UFIRState) -> AdaptiveState:
        """Go on from where a filter with one horizon stands; its window is kept."""
        new = object.__new__(cls)
        new.__setstate__(FilterState.__getstate__(state))
        new._empty()
        new.engine = state._to_records()
        new.policy, new.horizon, new.refreshed, new.stale = "adaptive", None, None, True
        return new

    def single(self, kind: type[UFIRState]) -> UFIRState:
        """Go on as a filter with one horizon, from the longest window there is."""
        new = object.__new__(kind)
        new.__setstate__(FilterState.__getstate__(self))
        for name in OWN:
            del new.__dict__[name]
        new.engine = self._longest()
        return new

    # -- the bank -----------------------------------------------------------------------------------------

    def refresh(self) -> None:
        """Look at the model: which candidates there are. At most once per horizon, as "auto" does."""
        if not self.stale:
            return
        if (
            self.refreshed is not None
            and self.index is not None
            and self.now - self.refreshed < (self.horizon or 0)
        ):
            return
        self.index = observability_index(self.model())
        self.refreshed, self.stale = self.now, False
        candidates = bank_candidates(self.dim_x if self.index is None else self.index)
        if self.bank is None or self.bank.candidates != candidates:
            self._open(candidates)
        for member in self.members:
            member.follow(self)

    def _open(self, candidates: tuple[int, ...]) -> None:
        past = self._longest()
        self.bank = HorizonBank(candidates)
        self.members = [self._member(horizon, past) for horizon in candidates]
        self.engine = None
        self.current = candidates.index(self.bank.best)
        self.horizon = self.bank.best
        self.X = np.full((len(candidates), self.dim_x), np.nan)
        for i, member in enumerate(self.members):
            if member.solution is not None:
                self.X[i] = member.solution.x
        self.stood = self.foretold = self.X
        self.errors = None
        self.past = deque(maxlen=self.members[-1].limits.reach)
        self.fed = self.now

    def _member(self, horizon: int, past: Records | None) -> Member:
        return Member(self, horizon, past)

    def _longest(self) -> Records | None:
        """The past as far back as anything remembers it."""
        if not self.members:
            return None if self.engine is None else super()._as_records()
        member = self.members[-1]
        member.settle()
        return member._as_records()

    def _as_records(self) -> Records:
        if not self.members:
            return super()._as_records()
        member = self.members[self.current]
        member.settle()
        return member._as_records()

    def _judge(self, z: Array, H: Array, R: Array, delay: int) -> None:
        """Squared whitened prediction errors of a row, one a candidate, to those of this step."""
        if delay > len(self.past):
            return
        if self.white is None or self.white[0] is not R:
            self.white = (R, whitener(R))
        X = self.past[-delay] if delay else self.foretold
        white = (z - X @ H.T) @ self.white[1].T
        errors = (white * white).sum(axis=1)
        self.errors = errors if self.errors is None else self.errors + errors

    def _score(self) -> None:
        """The end of a step: its rows count."""
        if self.errors is not None:
            # Errors grow with the time since the last row: the end of a gap must not outvote a hundred steps.
            lead = max(1, self.now - self.fed)
            self.bank.score(self.errors / lead**2)  # type: ignore[union-attr]
            self.errors, self.fed = None, self.now

    def _collect(self) -> None:
        """Estimates of all candidates after an update."""
        X = self.X.copy()
        for i, member in enumerate(self.members):
            if member.fresh:
                X[i] = member.estimate()
            elif member.solution is None:
                X[i] = np.nan
        self.X = self.stood = X

    def _follow_best(self) -> Member | None:
        """Publish the estimate of the best candidate, or the next longer one that has any; None if none."""
        self._collect()
        bank: HorizonBank = self.bank  # type: ignore[assignment]
        able = ~np.isnan(self.X[:, 0])
        if not able.any():
            return None
        best = bank.candidates.index(bank.best)
        longer = np.flatnonzero(able[best:])
        self.current = best + int(longer[0]) if len(longer) else int(np.flatnonzero(able)[-1])
        member = self.members[self.current]
        if member.fresh:
            member.look()
            self.solution, self.ready_at, self.horizon = member.solution, self.now, member.horizon
            self._publish(member.x, member.P)
        return member

    # -- hooks --------------------------------------------------------------------------------------------

    def _model_changed(self) -> None:
        super()._model_changed()
        for member in self.members:
            member.follow(self)

    def _advance(self, F: Array, Q: Array, known: Array | None) -> None:
        if self.stale:
            self.refresh()
        for member in self.members:
            member.step(F, Q, known)
        self._score()
        self.past.append(self.stood)
        moved = self.X @ F.T
        self.X = self.stood = self.foretold = moved if known is None else moved + known

    def _moved(self, delta: Array) -> None:
        super()._moved(delta)
        for member in self.members:
            member.edit(delta)
        self.X, self.foretold = self.X + delta, self.foretold + delta
        if not self.updated:
            self.stood = self.X

    def _absorb(self, z: Array, H: Array, R: Array, delay: int, cross: Array | None) -> Covariance | None:
        if self.stale:
            self.refresh()
        if delay and self._too_old(delay):
            self.dropped += 1
        for member in self.members:
            member.feed(z, H, R, delay)
        nothing = Covariance.of(np.zeros((self.dim_x, len(z))))
        if any(member.taken for member in self.members):
            self._judge(z, H, R, delay)
        elif self.missing == "extend":
            return nothing
        followed = self._follow_best()
        if followed is None:
            self.solution = None
            return nothing if delay else self._kalman(z, H, R, cross)
        return followed.solution.newest_gain if followed.taken and followed.solution else nothing

    def _skip(self) -> None:
        for member in self.members:
            member.feed(None, self.H.value, self.R.value, 0)
        if self.missing != "extend" and self.members and self._follow_best() is None:
            self.solution = None

    # -- what the window says -----------------------------------------------------------------------------

    @property
    def ready(self) -> bool:
        """Whether the rows that some candidate's window reaches determine the state."""
        if not self.members:
            return super().ready
        return self.solution is not None and any(
            member.ready for member in self.members[self.current :] + self.members
        )

    def __deepcopy__(self, memo: dict[int, Any]) -> UFIRState:
        fork = super().__deepcopy__(memo)
        for name in MODEL:
            # Frozen arrays may be shared, and the members know their model by identity.
            getattr(fork, name).share(getattr(self, name))
        own = {
            "bank": None if self.bank is None else self.bank.copy(),
            "members": [member.fork() for member in self.members],
            "past": self.past.copy(),
        }
        fork.__dict__.update(own)
        return fork
