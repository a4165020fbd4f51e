"""Whole frames of trackers of boxes: short tracks, growing windows, gaps, births and deaths."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any
from unittest import mock

import numpy as np

from benchmarks.boxes import Frames, crossing_boxes
from benchmarks.harness import Contest, Row, Run
from benchmarks.peers import peer
from benchmarks.sort import Sort

OBJECTS = 20


def _classes() -> tuple[type, type]:
    from ufirext import UFIRFilter

    return UFIRFilter, peer("filterpy.kalman", "filterpy").KalmanFilter


def _contest(follow: Callable[[type, Frames], Run], steps: int) -> Contest:
    """`follow` prepares a tracker whose filters are of a class; about `steps` boxes in all."""
    frames = crossing_boxes(np.random.default_rng(7), frames=max(steps // OBJECTS, 40), objects=OBJECTS)
    ours, theirs = _classes()
    return Contest(partial(follow, ours, frames), partial(follow, theirs, frames), len(frames))


def sort(cls: type, frames: Frames) -> Run:
    """SORT's own loop, written out in benchmarks/sort.py."""
    tracker = Sort(cls)

    def run() -> object:
        seen = np.zeros(4)
        for boxes in frames:
            found = tracker.update(boxes)
            if len(found):
                seen = found[:, 1:].mean(axis=0)
        return seen

    return run


def norfair(cls: type, frames: Frames) -> Run:
    """norfair with its filterpy factory."""
    package = peer("norfair", "norfair", options="--no-deps")
    module = peer("norfair.filter", "norfair", options="--no-deps")
    tracker = package.Tracker("iou", 0.7, filter_factory=module.FilterPyKalmanFilterFactory())

    def run() -> object:
        seen: list[Any] = [0.0]
        with mock.patch.object(module, "KalmanFilter", cls):
            for boxes in frames:
                tracked = tracker.update([package.Detection(box.reshape(2, 2)) for box in boxes])
                seen = [obj.estimate for obj in tracked] or seen
        return np.mean(seen)

    return run


def motpy(cls: type, frames: Frames) -> Run:
    """motpy, constant velocity and static box size."""
    package = peer("motpy", "motpy", options="--no-deps")
    module = peer("motpy.tracker", "motpy", options="--no-deps")
    tracker = package.MultiObjectTracker(dt=1.0)

    def run() -> object:
        seen: list[Any] = [0.0]
        with mock.patch.object(module, "KalmanFilter", cls):
            for boxes in frames:
                tracks = tracker.step([package.Detection(box=box, score=0.9) for box in boxes])
                seen = [track.box for track in tracks] or seen
        return np.mean(seen)

    return run


class _Tensor(np.ndarray):
    """An array with torch's .numpy(), which OC-SORT calls."""

    def numpy(self) -> np.ndarray:
        return np.asarray(self)


def ocsort(cls: type, frames: Frames) -> Run:
    """OC-SORT without its own Kalman filter's replay of lost boxes (no class but its own has that)."""
    package = peer("ocsort.ocsort", "ocsort", options="--no-deps")
    module = peer("ocsort.kalmanfilter", "ocsort", options="--no-deps")
    tracker = package.OCSort()
    scored = [np.column_stack([boxes, np.full(len(boxes), 0.9), np.zeros(len(boxes))]) for boxes in frames]

    def run() -> object:
        seen = np.zeros(1)
        with mock.patch.object(module, "KalmanFilterNew", cls):
            for detections in scored:
                found = tracker.update(detections.view(_Tensor), None)
                seen = found if len(found) else seen
        return seen.mean()

    return run


ROWS = [
    Row(
        f"trackers/{follow.__name__}",
        "one frame, about 20 boxes",
        f"{name} with KalmanFilter",
        1,
        partial(_contest, follow),
    )
    for follow, name in ((sort, "SORT"), (norfair, "norfair"), (motpy, "motpy"), (ocsort, "OC-SORT"))
]
