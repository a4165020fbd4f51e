"""Multi-object trackers from PyPI with UFIRFilter put where they build a KalmanFilter; SORT is the example.

Every tracker follows the same synthetic boxes with both filters: the identities must hold as well, and the
positions be as good within a stated factor. They skip where the tracker is not installed (NumPy 2 needs
them with --no-deps).
"""

from __future__ import annotations

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from .conftest import CLASSES

pytestmark = pytest.mark.filterwarnings("ignore")  # what third parties warn of is not ours

UFIR = pytest.mark.parametrize("name", [name for name in CLASSES if name != "filterpy" and name != "ufir-40"])
SEEDS = (0, 1)


@pytest.fixture(scope="module")
def scenes(sort_boxes):
    """(truth, detections) of a few scenes."""
    scene = sort_boxes.Scene(objects=5, frames=120)
    made = []
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        truth = scene.truth(rng)
        made.append((truth, list(scene.detections(truth, rng))))
    return made


def compare(sort_boxes, scenes, run, name, *, factor=1.25, switches=1):
    """Frames of {identity: box} from ``run(make_filter, frames)``, with KalmanFilter and with UFIRFilter."""
    of = {"kalman": KalmanFilter, "ufir": CLASSES[name]}
    scores = {
        who: [sort_boxes.score(truth, run(make, frames)) for truth, frames in scenes]
        for who, make in of.items()
    }

    def total(who, quantity):
        return np.sum([getattr(score, quantity) for score in scores[who]])

    assert total("kalman", "covered") > 0.7 * len(scenes)
    assert total("ufir", "switches") <= total("kalman", "switches") + switches
    assert total("ufir", "covered") >= total("kalman", "covered") - 0.02 * len(scenes)
    assert total("ufir", "rmse") <= factor * total("kalman", "rmse")


@UFIR
def test_sort_keeps_identities_and_positions(sort_boxes, scenes, name):
    def run(make, frames):
        return sort_boxes.track(frames, make)

    compare(sort_boxes, scenes, run, name)


def test_the_example_prints_one_line_a_filter(sort_boxes, capsys):
    sort_boxes.main(sort_boxes.Scene(objects=2, frames=30), range(1))
    heading, names, *lines = capsys.readouterr().out.splitlines()
    assert "2 objects x 30 frames x 1 scenes" in heading
    assert "identity switches" in names
    assert [line[:26].strip() for line in lines] == list(sort_boxes.FILTERS)


@UFIR
def test_norfair_keeps_identities_and_positions(sort_boxes, scenes, name, monkeypatch):
    """Two points a box; a detection of low score hides a point, which norfair turns into zero rows of H."""
    norfair = pytest.importorskip("norfair", exc_type=ImportError)
    from norfair import filter as norfair_filter

    def run(make, frames):
        monkeypatch.setattr(norfair_filter, "KalmanFilter", make)
        tracker = norfair.Tracker(
            distance_function="euclidean",
            distance_threshold=60.0,
            initialization_delay=2,
            detection_threshold=0.5,
            filter_factory=norfair_filter.FilterPyKalmanFilterFactory(R=4.0, Q=0.1),
        )
        rng = np.random.default_rng(9)
        for boxes in frames:
            scores = np.where(rng.random((len(boxes), 2)) < 0.05, 0.1, 1.0)
            corners = zip(boxes.reshape(-1, 2, 2), scores, strict=True)
            tracked = tracker.update([norfair.Detection(points, scores=seen) for points, seen in corners])
            yield {one.id: one.estimate.ravel() for one in tracked if one.live_points.all()}

    compare(sort_boxes, scenes, run, name)


@UFIR
def test_motpy_keeps_identities_and_positions(sort_boxes, scenes, name, monkeypatch):
    """Flat states; position of first order, size of zeroth."""
    motpy = pytest.importorskip("motpy", exc_type=ImportError)
    from motpy import tracker as motpy_tracker

    def run(make, frames):
        monkeypatch.setattr(motpy_tracker, "KalmanFilter", make)
        tracker = motpy.MultiObjectTracker(dt=1 / 24, tracker_kwargs={"max_staleness": 10})
        for boxes in frames:
            tracks = tracker.step([motpy.Detection(box=box, score=1.0) for box in boxes])
            yield {track.id: np.asarray(track.box) for track in tracks}

    compare(sort_boxes, scenes, run, name)


class Detections(np.ndarray):
    """What OC-SORT takes a detector's output for: an array that knows .numpy()."""

    def numpy(self):
        return np.asarray(self)


@UFIR
def test_ocsort_keeps_identities_and_positions(sort_boxes, scenes, name, monkeypatch):
    """OC-SORT brings a changed copy of filterpy's class, which fails on NumPy 2 after the first gap."""
    ocsort = pytest.importorskip("ocsort.ocsort", exc_type=ImportError)
    from ocsort import kalmanfilter

    def run(make, frames):
        monkeypatch.setattr(kalmanfilter, "KalmanFilterNew", make)
        tracker = ocsort.OCSort(det_thresh=0.3, max_age=10)
        for boxes in frames:
            extended = np.column_stack([boxes, np.ones(len(boxes)), np.zeros(len(boxes))])
            tracked = tracker.update(extended.view(Detections), None)
            numbers = {int(row[4]): row[:4] for row in tracked}
            states = {one.id + 1: one.get_state()[0].ravel()[:4] for one in tracker.trackers}
            yield {number: states[number] for number in numbers}

    compare(sort_boxes, scenes, run, name)
