"""The streaming oracle: an unbiased FIR filter that keeps everything and solves anew at every step.

Written from the rules of the contract alone: it shares no code with ufirext.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .oracles import (
    Array,
    Record,
    Stacked,
    brute_force_covariance,
    determined,
    kalman_update,
    naive_gain,
    observability_index,
    stacked,
)


@dataclass(frozen=True)
class _Row:
    """A record, and the edits of its own step that were made between the step's first row and itself."""

    record: Record
    shift: Array


class NaiveUFIR:
    """The streaming unbiased FIR filter, re-solved from all rows at every update.

    Time starts at step 0; a step is a `predict`. Known inputs and edits of x form a trajectory x_u that is 0
    at the oldest row: rows are solved as z - H x_u and the estimate adds x_u of now. Flat x, (n,).

    Parameters
    ----------
    F, H, Q, R : arrays
        Used where a call gives none.
    x, P : (n,), (n, n)
        Start of the warm-up's Kalman filter.
    horizon : int
    missing : "extend" or "skip"
    window : "arrivals" or "origins"
    """

    def __init__(self, F, H, Q, R, x, P, horizon, *, missing="extend", window="arrivals") -> None:
        self.F, self.H, self.Q, self.R = (np.asarray(a, dtype=float) for a in (F, H, Q, R))
        self.x, self.P = np.array(x, dtype=float), np.array(P, dtype=float)
        self.horizon, self.missing, self.by_arrival = horizon, missing, window == "arrivals"
        index = observability_index(self.F, self.H)
        self.instants = (index if index is not None else 1) + 2
        self.now = 0
        self.ready = False
        self.dropped = 0
        self.rows: list[_Row] = []
        self.first_F: Array | None = None
        self.transitions: dict[int, Array] = {}
        self.noises: dict[int, Array] = {}
        self.known: dict[int, Array] = {}  # inputs and edits before the first row of a step
        self.after: dict[int, Array] = {}  # edits after it
        self.updated = False

    # ---- verbs

    def predict(self, known=None, F=None, Q=None) -> None:
        """One step; `known` is B u, (n,)."""
        F = self.F if F is None else np.asarray(F, dtype=float)
        Q = self.Q if Q is None else np.asarray(Q, dtype=float)
        known = np.zeros(len(self.x)) if known is None else np.asarray(known, dtype=float)
        self.first_F = F if self.first_F is None else self.first_F
        self.now += 1
        self.transitions[self.now], self.noises[self.now] = F, Q
        self.known[self.now] = known
        self.x, self.P = F @ self.x + known, F @ self.P @ F.T + Q
        self.updated = False

    def edit(self, delta) -> None:
        """x was moved from outside; before the first update of a step, the step's rows see it."""
        delta = np.asarray(delta, dtype=float)
        self.x = self.x + delta
        part = self.after if self.updated else self.known
        part[self.now] = part.get(self.now, 0.0) + delta

    def update(self, z, R=None, H=None, *, delay: int = 0) -> None:
        """A measurement of `delay` steps ago; None or NaN is missing."""
        self.updated = True
        row = self._row(z, R, H, delay)
        if row is None:
            if self.missing == "skip":
                self._solve()
            return
        self.rows.append(row)
        if not self._solve() and delay == 0:
            record = row.record
            self.x, self.P = kalman_update(self.x, self.P, record.z, record.H, record.R)

    # ---- rules

    def _row(self, z, R, H, delay: int) -> _Row | None:
        if z is None:
            return None
        H = self.H if H is None else np.asarray(H, dtype=float)
        R = self.R if R is None else np.asarray(R, dtype=float)
        z = np.asarray(z, dtype=float).reshape(len(H))
        there = ~np.isnan(z) & (H != 0).any(axis=1)
        if not there.any():
            return None
        H, R, z = H[there], R[np.ix_(there, there)], z[there]
        origin = self.now - delay
        if delay >= (self._reach() if self.by_arrival else self.horizon):
            self.dropped += 1
            return None
        most = max((_information(row.record.H, row.record.R) for row in self._reachable()), default=0.0)
        if _information(H, R) < 1e-8 * most:
            return None
        shift = self.after.get(self.now, np.zeros(len(self.x))) if delay == 0 else np.zeros(len(self.x))
        return _Row(Record(origin, self.now, H, R, z), shift)

    def _reach(self) -> int:
        return 4 * self.horizon + 64 if self.missing == "extend" else self.horizon

    def _age(self, row: _Row) -> int:
        return self.now - (row.record.arrival if self.by_arrival else row.record.origin)

    def _reachable(self) -> list[_Row]:
        return [row for row in self.rows if self._age(row) < self._reach()]

    def _model(self) -> tuple[Mapping[int, Array], Mapping[int, Array]]:
        """Transitions and noises; before the first step the first F, Q without input."""
        oldest = min((row.record.origin for row in self.rows), default=0)
        first_F = self.F if self.first_F is None else self.first_F
        before = range(min(oldest, 0), 1)
        first_Q = self.noises.get(1, self.Q)
        return dict.fromkeys(before, first_F) | self.transitions, dict.fromkeys(before, first_Q) | self.noises

    def _trajectory(self, oldest: int) -> dict[int, Array]:
        """x_u as the first rows of each step from `oldest` on see it."""
        transitions, nothing = self._model()[0], np.zeros(len(self.x))
        result = {oldest: nothing}
        for step in range(oldest + 1, self.now + 1):
            before = result[step - 1] + self.after.get(step - 1, nothing)
            result[step] = transitions[step] @ before + self.known.get(step, nothing)
        return result

    def _regression(self, rows: Sequence[_Row], aim: int) -> tuple[Stacked, Array]:
        """The rows free of known inputs, and x_u at the aim."""
        trajectory = self._trajectory(min([aim, *(row.record.origin for row in rows)]))
        free = []
        for row in rows:
            r = row.record
            free.append(Record(r.origin, r.arrival, r.H, r.R, r.z - r.H @ (trajectory[r.origin] + row.shift)))
        return stacked(free, *self._model(), aim), trajectory[aim]

    def chosen(self) -> list[_Row] | None:
        """The rows of the window now; None where even the furthest reach does not determine the state."""
        ages = sorted({self._age(row) for row in self._reachable()})
        limit = self.horizon
        while True:
            rows = [row for row in self.rows if self._age(row) < limit]
            older = [age for age in ages if age >= limit]
            few = len({row.record.origin for row in rows}) < min(self.horizon, self.instants)
            if rows and not (few and older and self.missing == "extend"):
                window, _ = self._regression(rows, self.now)
                if determined(window.C, window.T):
                    return rows
            if not older or self.missing == "skip":
                return None
            limit = older[0] + 1

    def solution(self, lag: int = 0) -> tuple[Array, Array] | None:
        """Estimate and exact covariance of the state `lag` steps ago from the window of now."""
        rows = self.chosen()
        if rows is None:
            return None
        window, known = self._regression(rows, self.now - lag)
        if not determined(window.C, window.T):
            return None
        K = naive_gain(window)
        if lag == 0:
            known = known + self.after.get(self.now, 0.0)
        return K @ window.Z + known, brute_force_covariance(window, K)

    def _solve(self) -> bool:
        found = self.solution()
        self.ready = found is not None
        if found is not None:
            self.x, self.P = found
        return self.ready


def _information(H: Array, R: Array) -> float:
    return float(np.trace(H.T @ np.linalg.solve(R, H)))
