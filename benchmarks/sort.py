"""The loop of SORT (Bewley et al., "Simple online and realtime tracking", ICIP 2016), any filter class."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

__all__ = ["Sort"]


class Sort:
    """Tracks boxes frame by frame.

    Parameters
    ----------
    cls : type
        KalmanFilter or a class with its verbs; called as cls(dim_x=7, dim_z=4).
    max_age : int
        Frames a track survives without a detection.
    min_hits : int
        Detections in a row before a track is reported.
    """

    def __init__(self, cls: type, *, max_age: int = 5, min_hits: int = 3, min_overlap: float = 0.3) -> None:
        self.cls = cls
        self.max_age = max_age
        self.min_hits = min_hits
        self.min_overlap = min_overlap
        self.tracks: list[_Track] = []
        self.born = 0

    def update(self, boxes: np.ndarray) -> np.ndarray:
        """One frame: (n, 4) detections in, (m, 5) rows of identity and box out."""
        predicted = np.array([track.predict() for track in self.tracks]).reshape(-1, 4)
        pairs = _matches(boxes, predicted, self.min_overlap)
        for box, track in pairs:
            self.tracks[track].update(boxes[box])
        for box in set(range(len(boxes))) - {box for box, _ in pairs}:
            self.tracks.append(_Track(self.cls, boxes[box], self.born))
            self.born += 1
        self.tracks = [track for track in self.tracks if track.misses <= self.max_age]
        shown = [t for t in self.tracks if t.misses == 0 and t.streak >= self.min_hits]
        return np.array([[t.identity, *t.box()] for t in shown]).reshape(-1, 5)


class _Track:
    """One object: state [centre x, y, area, aspect, and the speeds of the first three]."""

    def __init__(self, cls: type, box: np.ndarray, identity: int) -> None:
        self.identity = identity
        self.misses = self.streak = 0
        self.f: Any = cls(dim_x=7, dim_z=4)
        self.f.F = np.eye(7) + np.eye(7, k=4)
        self.f.H = np.eye(4, 7)
        self.f.R[2:, 2:] *= 10.0
        self.f.P[4:, 4:] *= 1000.0
        self.f.P *= 10.0
        self.f.Q[-1, -1] *= 0.01
        self.f.Q[4:, 4:] *= 0.01
        self.f.x[:4] = _measurement(box)

    def predict(self) -> np.ndarray:
        if self.f.x[6, 0] + self.f.x[2, 0] <= 0:
            self.f.x[6] = 0.0  # SORT: an area must not shrink below zero
        self.f.predict()
        self.misses += 1
        return self.box()

    def update(self, box: np.ndarray) -> None:
        self.streak = self.streak + 1 if self.misses <= 1 else 1
        self.misses = 0
        self.f.update(_measurement(box))

    def box(self) -> np.ndarray:
        x, y, area, aspect = self.f.x[:4, 0]
        width = np.sqrt(max(area * aspect, 1.0))
        height = max(area, 1.0) / width
        return np.array([x - width / 2, y - height / 2, x + width / 2, y + height / 2])


def _measurement(box: np.ndarray) -> np.ndarray:
    width, height = box[2:] - box[:2]
    return np.array([[box[0] + width / 2], [box[1] + height / 2], [width * height], [width / height]])


def _matches(boxes: np.ndarray, predicted: np.ndarray, least: float) -> list[tuple[int, int]]:
    """Pairs (box, track) of greatest total overlap, those below `least` left out."""
    if not len(boxes) or not len(predicted):
        return []
    low = np.maximum(boxes[:, None, :2], predicted[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], predicted[None, :, 2:])
    common = np.prod(np.clip(high - low, 0, None), axis=2)
    areas = [np.prod(b[:, 2:] - b[:, :2], axis=1) for b in (boxes, predicted)]
    overlap = common / (areas[0][:, None] + areas[1][None, :] - common)
    pairs = zip(*(indices.tolist() for indices in linear_sum_assignment(-overlap)), strict=True)
    return [(i, j) for i, j in pairs if overlap[i, j] >= least]
