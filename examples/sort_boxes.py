"""SORT on synthetic boxes, with filterpy's KalmanFilter and with UFIRFilter: one argument changes.

SORT (Bewley, Ge, Ott, Ramos and Upcroft, "Simple online and realtime tracking", ICIP 2016) follows
boxes through a video: every track carries a filter of constant velocity, and in every frame the
predicted boxes are matched with the detected ones by their overlap. Written after the paper's
description. The state is

    [u, v, s, r, u', v', s'],  centre (pixels), area, aspect ratio, and rates of the first three

of which the first four are measured. Nothing below knows which filter it runs: the class handed to
`track` is all that differs. Run it with `python examples/sort_boxes.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from ufirext import UFIRFilter

Boxes = NDArray[np.float64]  # (number, 4): left, top, right, bottom, in pixels
MakeFilter = Callable[..., Any]

MIN_OVERLAP = 0.3  # below this, a detection and a track are not the same object
MAX_AGE = 10  # frames a track lives on without a detection (the paper: 1)
MIN_HITS = 3  # detections before a track is believed


def box_to_measurement(box: Boxes) -> Boxes:
    """[u, v, s, r] of a box, as the column that filterpy's filters take."""
    width, height = box[2:] - box[:2]
    u, v = (box[2:] + box[:2]) / 2
    return np.array([[u], [v], [width * height], [width / height]])


def state_to_box(x: Boxes) -> Boxes:
    """The box of a state; an area that was predicted below one pixel is taken as one pixel."""
    u, v, area, ratio = x.ravel()[:4]
    width = np.sqrt(max(area, 1.0) * max(ratio, 1e-3))
    half = np.array([width, max(area, 1.0) / width]) / 2
    return np.array([u - half[0], v - half[1], u + half[0], v + half[1]])


def overlaps(boxes: Boxes, others: Boxes) -> Boxes:
    """Intersection over union of every box with every other, (boxes, others)."""
    corner = np.maximum(boxes[:, None, :2], others[None, :, :2])
    opposite = np.minimum(boxes[:, None, 2:], others[None, :, 2:])
    intersection = np.prod(np.clip(opposite - corner, 0.0, None), axis=2)
    areas = [np.prod(group[:, 2:] - group[:, :2], axis=1) for group in (boxes, others)]
    union: Boxes = areas[0][:, None] + areas[1][None, :] - intersection
    ratio: Boxes = intersection / union
    return ratio


def matches(overlap: Boxes) -> list[tuple[int, int]]:
    """Pairs (row, column) of the assignment of greatest total overlap, less those of too little."""
    rows, columns = linear_sum_assignment(-overlap)
    pairs = zip(rows.tolist(), columns.tolist(), strict=True)
    return [(row, column) for row, column in pairs if overlap[row, column] >= MIN_OVERLAP]


class BoxTrack:
    """One object: a filter over [u, v, s, r, u', v', s'], how often and how lately it was seen."""

    def __init__(self, number: int, box: Boxes, make_filter: MakeFilter) -> None:
        self.number, self.hits, self.unseen = number, 1, 0
        self.filter = make_filter(dim_x=7, dim_z=4)
        self.filter.F = np.eye(7) + np.eye(7, k=4)  # u += u', v += v', s += s'
        self.filter.H = np.eye(4, 7)
        self.filter.R = np.diag(
            [1.0, 1.0, 10.0, 10.0]
        )  # area and shape are measured less well than the place
        self.filter.P = np.diag([10.0] * 4 + [1e4] * 3)  # the rates are unknown at first
        self.filter.Q = np.diag([1.0] * 4 + [0.01, 0.01, 0.0001])
        self.filter.x[:4] = box_to_measurement(box)

    def predict(self) -> Boxes:
        """Move to the next frame; the predicted box."""
        if self.filter.x[2, 0] + self.filter.x[6, 0] <= 0:
            self.filter.x[6, 0] = 0.0  # an area does not shrink below nothing
        self.filter.predict()
        self.unseen += 1
        return self.box

    def update(self, box: Boxes) -> None:
        """A detection was matched with this track."""
        self.filter.update(box_to_measurement(box))
        self.hits += 1
        self.unseen = 0

    @property
    def box(self) -> Boxes:
        """The box as estimated now."""
        return state_to_box(self.filter.x)


class Sort:
    """Tracks, and their assignment to the detections of a frame."""

    def __init__(self, make_filter: MakeFilter) -> None:
        self.make_filter = make_filter
        self.tracks: list[BoxTrack] = []
        self.born = 0

    def step(self, detections: Boxes) -> dict[int, Boxes]:
        """One frame; the boxes of the tracks seen in it, by track number."""
        predicted = np.array([track.predict() for track in self.tracks]).reshape(-1, 4)
        overlap = overlaps(detections, predicted)
        new = set(range(len(detections)))
        for detection, track in matches(overlap):
            self.tracks[track].update(detections[detection])
            new.discard(detection)
        for detection in sorted(new):
            self.tracks.append(BoxTrack(self.born, detections[detection], self.make_filter))
            self.born += 1
        self.tracks = [track for track in self.tracks if track.unseen <= MAX_AGE]
        return {t.number: t.box for t in self.tracks if t.unseen == 0 and t.hits >= MIN_HITS}


@dataclass(frozen=True)
class Scene:
    """Pedestrians of constant velocity who stop dead and turn back, and a detector with misses."""

    objects: int = 6
    frames: int = 200
    sigma: float = 2.0  # pixels, of each side of a box
    missed: float = 0.1  # share of detections that fail

    def truth(self, rng: np.random.Generator) -> Boxes:
        """True boxes, (frames, objects, 4), in lanes apart: it is the filter that is tested."""
        centre = np.stack(
            [rng.uniform(200, 1000, self.objects), 150.0 * np.arange(1, self.objects + 1)], axis=1
        )
        speed = np.stack(
            [rng.uniform(2, 6, self.objects), rng.uniform(-0.3, 0.3, self.objects)], axis=1
        )
        size = np.stack(
            [rng.uniform(40, 60, self.objects), rng.uniform(90, 120, self.objects)], axis=1
        )
        turn = rng.integers(60, 140, self.objects)
        frames = []
        for frame in range(self.frames):
            centre = centre + np.where(frame < turn, 1.0, -1.0)[:, None] * speed
            frames.append(np.concatenate([centre - size / 2, centre + size / 2], axis=1))
        return np.array(frames)

    def detections(self, truth: Boxes, rng: np.random.Generator) -> Iterator[Boxes]:
        """What the detector reports, frame by frame, in no particular order."""
        for boxes in truth:
            seen = boxes[rng.random(len(boxes)) >= self.missed]
            yield rng.permutation(seen + self.sigma * rng.standard_normal(seen.shape))


@dataclass(frozen=True)
class Score:
    """How well the tracks follow the truth."""

    switches: int  # times that an object was continued under another number
    covered: float  # share of the objects' frames in which a track overlaps them
    rmse: float  # of the centres of the overlapping tracks, pixels


def track(frames: Iterable[Boxes], make_filter: MakeFilter) -> list[dict[int, Boxes]]:
    """SORT over all frames."""
    sort = Sort(make_filter)
    return [sort.step(detections) for detections in frames]


def score(truth: Boxes, tracks: Iterable[dict[Any, Boxes]]) -> Score:
    """Match tracks and true boxes in every frame by overlap."""
    last: dict[int, Any] = {}
    switches = 0
    errors: list[Boxes] = []
    for boxes, present in zip(truth, tracks, strict=True):
        numbers, estimated = list(present), np.array(list(present.values())).reshape(-1, 4)
        overlap = overlaps(boxes, estimated)
        for who, index in matches(overlap):
            switches += int(last.get(who, numbers[index]) != numbers[index])
            last[who] = numbers[index]
            errors.append((boxes[who] - estimated[index]).reshape(2, 2).mean(axis=0))
    rmse = float(np.sqrt(np.mean(np.square(errors)))) if errors else float("nan")
    return Score(switches, len(errors) / truth[:, :, 0].size, rmse)


FILTERS: dict[str, MakeFilter] = {
    "KalmanFilter (filterpy)": KalmanFilter,
    "UFIRFilter, auto": UFIRFilter,
    "UFIRFilter, N = 6": partial(UFIRFilter, horizon=6),
    "UFIRFilter, N = 10": partial(UFIRFilter, horizon=10),
}


def compare(scene: Scene, seeds: Iterable[int]) -> dict[str, list[Score]]:
    """Every filter on the same detections."""
    results: dict[str, list[Score]] = {name: [] for name in FILTERS}
    for seed in seeds:
        rng = np.random.default_rng(seed)
        truth = scene.truth(rng)
        frames = list(scene.detections(truth, rng))
        for name, make_filter in FILTERS.items():
            results[name].append(score(truth, track(frames, make_filter)))
    return results


def main(scene: Scene = Scene(), seeds: Sequence[int] = range(5)) -> None:
    """Print the comparison."""
    print(
        f"SORT, {scene.objects} objects x {scene.frames} frames x {len(seeds)} scenes; "
        f"detections with sigma = {scene.sigma:g} px, {100 * scene.missed:.0f} % missed"
    )
    print(f"{'filter':26}{'identity switches':>18}{'covered':>10}{'centre RMSE, px':>18}")
    for name, scores in compare(scene, seeds).items():
        switches = sum(one.switches for one in scores)
        covered = np.mean([one.covered for one in scores])
        rmse = np.sqrt(np.mean([one.rmse**2 for one in scores]))
        print(f"{name:26}{switches:18d}{100 * covered:9.1f}%{rmse:18.2f}")


if __name__ == "__main__":
    main()
