"""The hot path's hands on a full window with known inputs: z and what is known of each step, side by side.

x = sum of G_i z_i + D_i k_i over the window, z_i the row and k_i the known change of x at step i: what a gain
says of a driven model is one constant product as well (`Plan.driven`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .._arrays import FLOAT, Array
from .lean import Hands, Intake, Reading, numbers
from .ring import Ring
from .trajectory import Trajectory

__all__ = ["Driven", "drivable"]

ARRAY = np.ndarray


def drivable(ring: Ring) -> bool:
    """Whether the window is full of plain rows, and there is a gain on these and what is known."""
    inputs = ring.inputs
    if inputs is None or inputs.after is not None or ring.spread:
        return False
    return ring.full and ring.plan.driven is not None


class Driven:
    """What can be done to a full window of plain rows whose steps have known inputs.

    `push(B, u)` notes B u of the step to come in `inputs.coming`, False where u is not plainly a finite
    array, `nudge(delta)` what an edit of x adds to it; put(z) of the `hands` goes on by a step with it and a
    row. The ring itself only learns where its end is: `enter` and `sync` bring both up to date.
    """

    def __init__(self, ring: Ring, inputs: Trajectory) -> None:
        self.ring, self.inputs = ring, inputs
        model = ring.plan.model
        self.cells = np.zeros((ring.capacity, model.dim_z + model.dim_x))
        self.synced = ring.now
        gain: Array = ring.plan.driven  # type: ignore[assignment]
        flat, column = self._reading(gain, False), self._reading(gain, True)
        self.hands: Hands = self._putting(), (flat, column)
        self.push = self._pushing()

    def enter(self) -> None:
        """The ring has gone on by itself."""
        ring, m = self.ring, self.ring.free.shape[1]
        window = slice(ring.end - ring.limits.horizon, ring.end)
        self.cells[window, :m] = ring.raw[window]  # type: ignore[index]
        self.cells[window, m:] = self.inputs.known[window]
        self.synced = ring.now

    def sync(self) -> None:
        """Let the ring know what came: x_u, and the rows as they are seen against it."""
        ring, inputs, horizon = self.ring, self.inputs, self.ring.limits.horizon
        steps, end, model = ring.now - self.synced, ring.end, ring.plan.model
        raw: Array = ring.raw  # type: ignore[assignment]
        since, low = end - min(steps, ring.keep), end - steps
        raw[since:end] = self.cells[since:end, : model.dim_z]
        inputs.known[since:end] = self.cells[since:end, model.dim_z :]
        x = inputs.now
        if steps > horizon:  # x_u starts anew, at the oldest row of the window a step ago
            low = end - horizon
            x = inputs.path[low - 1] = np.zeros(model.dim_x)
            ring.free[low - 1] = raw[low - 1]
            inputs.rebased, inputs.valid_from = ring.now, ring.base + low - 1
        for slot in range(low, end):
            x = inputs.path[slot] = model.F.dot(x) + inputs.known[slot]
        inputs.now = x
        ring.free[low:end] = raw[low:end] - inputs.path[low:end] @ model.H.T
        self.synced = ring.now

    def nudge(self, delta: Array) -> None:
        """x was moved by delta, after the row of this step."""
        inputs, ahead = self.inputs, self.ring.plan.model.F.dot(delta)
        if inputs.coming is None:
            inputs.coming = self.cells[self.ring.end, self.ring.free.shape[1] :]
            inputs.coming[:] = ahead
        else:
            inputs.coming += ahead

    def _pushing(self) -> Callable[[Array, Any], bool]:
        ring, inputs, cells, m = self.ring, self.inputs, self.cells, self.ring.free.shape[1]
        views: list[tuple[Array, Array] | None] = [None] * ring.capacity
        matrix: Array | None = None
        values_of = numbers(1)

        def view(end: int) -> tuple[Array, Array]:
            change = cells[end, m:]
            views[end] = found = change, change.reshape(-1, 1)
            return found

        def push(B: Array, u: Any) -> bool:
            nonlocal matrix, values_of
            if B is not matrix:
                matrix, values_of = B, numbers(B.shape[1])
            if u.__class__ is not ARRAY or values_of(u) is None:
                return False
            end = ring.end
            flat, column = views[end] or view(end)
            if u.ndim == 1:
                B.dot(u, flat)
            elif u.shape[1] == 1:
                B.dot(u, column)
            else:
                return False
            inputs.coming = flat
            return True

        return push

    def _putting(self) -> Intake:
        ring, inputs, cells = self.ring, self.inputs, self.cells
        m, capacity, keep = ring.free.shape[1], ring.capacity, ring.keep
        width, start = cells.shape[1], m * FLOAT.itemsize
        row = width * FLOAT.itemsize
        nothing = bytes(row - start)
        values_of = numbers(m)
        written: Any = cells.reshape(-1).data
        wiped: Any = written.cast("B")

        def put(z: Any) -> bool:
            values = values_of(z)
            if values is None:
                return False
            end = ring.end
            if inputs.coming is not None:
                inputs.coming = None
            elif end + 1 == capacity and not cells[end + 1 - keep : end, m:].any():
                inputs.over = True  # the slow path will forget them
                return False
            else:
                wiped[end * row + start : (end + 1) * row] = nothing
            at = end * width
            for value in values:
                written[at] = value
                at += 1
            ring.newest_age, ring.end = 0, end + 1
            if end + 1 == capacity:
                ring.compact()
                cells[:keep] = cells[capacity - keep :].copy()
            return True

        return put

    def _reading(self, gain: Array, column: bool) -> Reading:
        ring, flat, length, width = self.ring, self.cells.reshape(-1), gain.shape[1], self.cells.shape[1]
        product: Callable[[Array], Array] = gain.dot
        views: list[Array | None] = [None] * (ring.capacity + 1)

        def read() -> Array:
            end = ring.end
            view = views[end]
            if view is None:
                view = flat[end * width - length : end * width]
                view = views[end] = view.reshape(-1, 1) if column else view
            return product(view)

        return read
