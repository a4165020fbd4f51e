"""Synthetic detections for trackers."""

from __future__ import annotations

import numpy as np

__all__ = ["Frames", "crossing_boxes"]

Frames = list[np.ndarray]
"""One (n, 4) array a frame: x1, y1, x2, y2 in pixels."""


def crossing_boxes(rng: np.random.Generator, *, frames: int, objects: int) -> Frames:
    """Boxes that cross the picture, live 20 to 120 frames, are missed at random and hide behind things.

    Every box drawn is jittered by one pixel; one in ten is missed, and once in fifty frames an object
    disappears for 3 to 8 frames. A dead object is replaced by a new one elsewhere.
    """
    cast = [_Object(rng) for _ in range(objects)]
    film = []
    for _ in range(frames):
        for index, actor in enumerate(cast):
            if actor.left == 0:
                cast[index] = _Object(rng)
        shown = [box for actor in cast if (box := actor.step(rng)) is not None]
        film.append(np.array(shown).reshape(-1, 4))
    return film


class _Object:
    """One box: centre, velocity, size, frames left to live and to hide."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.centre = rng.uniform(0, 2000, 2)
        self.velocity = rng.uniform(-6, 6, 2)
        self.size = rng.uniform(40, 120, 2)
        self.left = int(rng.integers(20, 120))
        self.hidden = 0

    def step(self, rng: np.random.Generator) -> np.ndarray | None:
        """Move by one frame; the detected box, or None where it was missed."""
        self.left -= 1
        self.velocity += rng.normal(0, 0.2, 2)
        self.centre += self.velocity
        if self.hidden == 0 and rng.random() < 0.02:
            self.hidden = int(rng.integers(3, 9))
        if self.hidden > 0:
            self.hidden -= 1
            return None
        if rng.random() < 0.1:
            return None
        half = self.size / 2
        box: np.ndarray = np.concatenate([self.centre - half, self.centre + half]) + rng.normal(0, 1, 4)
        return box
