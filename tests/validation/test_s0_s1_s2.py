"""The items on the GPS papers: linear filters over many runs, common random numbers, every printed number."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from ufirext import DelayHInfinityFilter, DelayKalmanFilter, StampedLoss, UFIRFilter
from validation import linear, s0, s1, s2, scores
from validation.beyond import hinfinity_gap, late_kalman, outliers, real_tracks, wrong_noise
from validation.claims import Verdict
from validation.drives import STEPS, Scene, constant_delay, scenes
from validation.item import CannotRun, Item
from validation.linear import Finite, recursion
from validation.s0.filters import MODEL, effective, kalman, robust, theta_limit, ufir
from validation.s1.filters import groups
from validation.s1.filters import kalman as network_kalman
from validation.s2 import cells, tables
from validation.s2.filters import averaged, drawn, expectation
from validation.s2.filters import kalman as averaged_kalman
from validation.s2.filters import ufir as averaged_ufir
from validation.study import Study

ITEMS = {item.id: item for item in (*s0.ITEMS, *s1.ITEMS, *s2.ITEMS)}
FAST = ("s0-fig-4", "s0-fig-5", "s2-fig-2", "s2-fig-3")
QUIET = (
    tables.TABLE_1,
    tables.TABLE_2,
    late_kalman.ITEM,
    hinfinity_gap.ITEM,
    outliers.ITEM,
    wrong_noise.ITEM,
)


@pytest.fixture(scope="module")
def late() -> Scene:
    return scenes(Study("s0-fig-3"), constant_delay(3), 2)


def streamed(f, scene: Scene, model=MODEL, believed=None) -> np.ndarray:
    """One filter of the library, run by run and step by step."""
    f.F, f.H, f.Q, f.R = model.F, (believed or model).H, model.Q, (believed or model).R
    zs, delays = scene.zs[0], scene.delays[0]
    first = zs[np.isfinite(zs).all(axis=1)][0]
    f.x = np.array([first[0], 0.0, first[1], 0.0])
    states = []
    for z, delay in zip(zs, delays, strict=True):
        f.predict()
        f.update(None if delay is None else z, delay=0 if believed else delay or 0)
        states.append(f.x.ravel())
    return np.array(states)


@pytest.mark.parametrize("method", ["white", "exact"])
def test_gains_applied_to_all_runs_are_the_filter_itself(late: Scene, method: str) -> None:
    states = streamed(DelayKalmanFilter(4, 2, max_delay=3, method=method), late)
    np.testing.assert_allclose(kalman(3, method).track(late.zs)[0], states, atol=1e-6)


def test_the_same_with_stamps_and_losses() -> None:
    group = groups(Study("s1-fig-2"), 3)[0]
    f = DelayKalmanFilter(4, 2, channel=StampedLoss(0.7, 0.9), method="correlated")
    scene = Scene(group.truth, group.zs, np.zeros(group.zs.shape[:2], dtype=np.int64))
    f.F, f.H, f.Q, f.R = MODEL.F, MODEL.H, MODEL.Q, MODEL.R
    first = scene.zs[0][np.isfinite(scene.zs[0]).all(axis=1)][0]
    f.x = np.array([first[0], 0.0, first[1], 0.0])
    states = []
    for z, delay in zip(scene.zs[0], group.delays, strict=True):
        f.predict()
        f.update(None if delay is None else z, delay=delay or 0)
        states.append(f.x.ravel())
    np.testing.assert_allclose(network_kalman(group, 3, MODEL).track(group.zs)[0], states, atol=1e-6)


def test_the_same_for_h_infinity(late: Scene) -> None:
    after = Scene(late.truth[:, 3:], late.zs[:, 3:], late.origins[:, 3:])
    f = DelayHInfinityFilter(4, 2, theta=1e-4, form="mixed")
    states = streamed(f, after, believed=effective(3))
    # Before anything arrives the many-runs form moves on from rest, which is to stay.
    np.testing.assert_allclose(robust(3, 1e-4).track(late.zs)[0, 3:], states, atol=1e-6)


def test_a_window_of_late_data_is_the_window_moved_ahead(late: Scene) -> None:
    states = streamed(UFIRFilter(4, 2, horizon=5), late)
    np.testing.assert_allclose(ufir(3).track(late.zs)[0, 20:], states[20:], atol=1e-8)


def test_delays_have_the_same_drives_and_the_same_noise() -> None:
    study = Study("s0-fig-3")
    now, then = scenes(study, constant_delay(0), 2), scenes(study, constant_delay(4), 2)
    np.testing.assert_array_equal(now.truth, then.truth)
    np.testing.assert_array_equal(now.zs[:, : STEPS - 4], then.zs[:, 4:])


def test_networks_have_the_same_tracks() -> None:
    study = Study("s1-fig-3")
    for one, other in zip(groups(study, 3), groups(study, 5), strict=True):
        np.testing.assert_array_equal(one.truth, other.truth)
        assert one.delays != other.delays


def test_no_datum_counts_twice() -> None:
    for group in groups(Study("s1-fig-3"), 3):
        origins = [step - delay for step, delay in enumerate(group.delays) if delay is not None]
        assert len(origins) == len(set(origins))


@pytest.mark.parametrize("make", [averaged_ufir, averaged_kalman])
def test_expected_errors_are_the_mean_of_the_drawn_ones(make) -> None:
    study = Study("s2-table-1")
    scene = drawn(study, 24)
    tracker = make(0.5)
    found = scores.squares(tracker.track(scene.zs), scene.truth)
    expected = expectation(tracker, scene.truth)
    score = scores.ratio(found, expected)
    assert abs(score.value - 1.0) < 4.0 * score.error < 0.05


def test_scores_know_their_chance() -> None:
    rng = np.random.default_rng(0)
    found = [scores.rmse(rng.chisquare(100, 50) / 100.0) for _ in range(200)]
    scatter = float(np.std([score.value for score in found]))
    assert np.mean([score.error for score in found]) == pytest.approx(scatter, rel=0.2)
    assert scores.ratio(np.array([4.0, 8.0]), np.array([1.0, 2.0])) == (2.0, 0.0, 0.0)
    assert math.isinf(scores.rmse(np.array([1.0, np.inf])).value)


def test_the_paper_limit_is_that_of_the_a_posteriori_filter() -> None:
    assert theta_limit(2) == pytest.approx(theta_limit(2, "posterior"), rel=0.02)
    assert theta_limit(2, "prior") < theta_limit(2)


def test_the_covariance_of_any_gain_is_the_optimum_for_the_exact_one() -> None:
    found, believed = late_kalman.gains("exact", 3)
    assert math.sqrt(late_kalman.true_covariance(found, 3)[0, 0]) == pytest.approx(believed, rel=1e-9)
    worse = replace(found, K=1.05 * found.K)
    assert late_kalman.true_covariance(worse, 3)[0, 0] > late_kalman.true_covariance(found, 3)[0, 0]


@pytest.mark.parametrize("name", FAST)
def test_items_keep_their_promises_and_their_numbers(name: str) -> None:
    first, second = (ITEMS[name].run(Study(name)) for _ in range(2))
    assert {claim.name for claim in first.claims} == set(ITEMS[name].claims)
    assert not [claim.name for claim in first.claims if claim.verdict.fails]
    assert [claim.ours for claim in first.claims] == [claim.ours for claim in second.claims]


@pytest.mark.parametrize("item", QUIET, ids=lambda item: item.id)
def test_items_keep_their_promises(item: Item) -> None:
    outcome = item.run(Study(item.id))
    assert {claim.name for claim in outcome.claims} == set(item.claims)
    assert not [claim.name for claim in outcome.claims if claim.verdict.fails]


def test_every_number_of_the_tables_is_a_claim() -> None:
    printed = {beta: {v for row in rows.values() for v in row} for beta, rows in cells.PRINTED.items()}
    assert {len(values) for values in printed.values()} == {9}
    for beta, item in ((1.0, tables.TABLE_1), (0.5, tables.TABLE_2)):
        found = cells.cells(Study(item.id), beta)
        claims = tables._about_cells(item.id, found)
        reported = {claim.reported for claim in claims if isinstance(claim.reported, float)}
        assert reported == {value for value in printed[beta] if math.isfinite(value)}
        diverging = [claim for claim in claims if not isinstance(claim.reported, float)]
        assert len(diverging) == sum(map(math.isinf, printed[beta]))
        assert all(claim.verdict is Verdict.REPRODUCED for claim in diverging)
        assert {claim.name for claim in claims} <= set(item.claims)


@pytest.mark.parametrize(
    ("name", "numbers"),
    [
        (
            "s0-fig-3",
            ["theta_opt, k = 0", "theta_opt, k = 2", "theta_opt, k = 10", "N_opt, k = 10", "7.1e-4"],
        ),
        ("s0-fig-4", ["3.3e-4"]),
        ("s0-fig-5", ["615 to 620", "665 to 675"]),
        ("s2-fig-4", ["beta below which UFIR", "beta above which UFIR", "beta below which H-inf diverges"]),
    ],
)
def test_every_number_of_the_text_is_a_claim(name: str, numbers: list[str]) -> None:
    for number in numbers:
        assert any(re.search(re.escape(number), claim) for claim in ITEMS[name].claims), number


def test_there_is_an_item_for_every_table_and_figure() -> None:
    figures = {"s0": (3, 4, 5), "s1": range(2, 8), "s2": range(2, 6)}
    expected = {f"{paper}-fig-{number}" for paper, numbers in figures.items() for number in numbers}
    assert set(ITEMS) == expected | {"s2-table-1", "s2-table-2"}


def test_a_wrong_sign_in_a_gain_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    right = linear.ufir_gain

    class Turned:
        def __init__(self, model, horizon) -> None:
            self.K = right(model, horizon).K.copy()
            self.K[2] = -self.K[2]

    monkeypatch.setattr(linear, "ufir_gain", Turned)
    for name in ("s0-fig-4", "s2-fig-3"):
        claims = ITEMS[name].run(Study(name)).claims
        assert any(claim.verdict.fails for claim in claims), name


def test_real_tracks_say_why_they_cannot_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("UFIREXT_DATA", raising=False)
    with pytest.raises(CannotRun, match="UFIREXT_DATA"):
        real_tracks.ITEM.run(Study(real_tracks.ITEM.id))


def test_gains_are_asked_once_they_have_settled() -> None:
    """Steps of a settled filter are not run: the gains of a long series are those of a short one."""
    long, short = (recursion(DelayKalmanFilter(4, 2), averaged(0.8), [0] * n) for n in (400, 60))
    np.testing.assert_allclose(long.K[-1], short.K[-1], rtol=1e-9)
    assert Finite.ufir(averaged(0.8), 5).track(np.ones((1, 10, 2)))[0, -1, 0] == pytest.approx(1.0)
