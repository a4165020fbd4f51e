"""The comparison is fair: every filter sees the same packets, and the scores are what they are called."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pandas", reason="pip install ufirext[cli]")

from ufirext import UfirextError
from ufirext.demo.compare import (
    CONTENDERS,
    SCENARIOS,
    SETTLING,
    Contender,
    Trial,
    compare,
    estimate,
    models,
    rmse,
    tuned_density,
)
from ufirext.demo.scene import LONGEST, city, recorded
from ufirext.demo.simulate import Drive, Link, city_drive, transmit

KALMAN = Contender("KalmanFilter", None, late="as new")


def short_trial(rng: np.random.Generator, q: float = 1.0, r: float = 9.0, steps: int = 150) -> Trial:
    drive = city_drive(rng, duration=steps - 1.0)
    measured = drive.position + np.sqrt(r) * rng.standard_normal(drive.position.shape)
    return Trial(drive, measured, models(drive.seconds, q, r))


def test_rmse_is_the_root_of_the_mean_squared_distance_after_settling() -> None:
    truth = np.zeros((SETTLING + 2, 2))
    positions = truth.copy()
    positions[:SETTLING] = 1e6
    positions[SETTLING:] = [[3.0, 4.0], [0.0, 1.0]]
    assert rmse(positions, truth) == pytest.approx(np.sqrt((25.0 + 1.0) / 2))


def test_only_the_ratio_of_q_and_r_matters_to_a_settled_kalman_filter() -> None:
    """Hence one row of the table for `Q x 100 (or R / 100)`."""
    perfect = transmit(np.random.default_rng(0), 150, Link())
    livelier = estimate(Contender("", None, 100.0), short_trial(np.random.default_rng(1)), perfect)
    surer = estimate(KALMAN, short_trial_with_r(np.random.default_rng(1), 9.0 / 100), perfect)
    np.testing.assert_allclose(livelier[60:], surer[60:], atol=1e-6)


def short_trial_with_r(rng: np.random.Generator, assumed: float) -> Trial:
    trial = short_trial(rng)
    return Trial(trial.drive, trial.measured, models(trial.drive.seconds, 1.0, assumed))


@pytest.mark.parametrize("horizon", [None, "auto"])
def test_how_late_packets_are_treated_does_not_matter_where_none_is_late(horizon: str | None) -> None:
    trial = short_trial(np.random.default_rng(2))
    arrivals = transmit(np.random.default_rng(0), 150, Link(loss=0.2))
    runs = [estimate(Contender("", horizon, late=late), trial, arrivals) for late in ("as new", "dropped")]
    np.testing.assert_array_equal(*runs)


def test_packets_that_all_come_two_steps_late_shift_ufir_by_two_predictions() -> None:
    """At constant delay k UFIR_n = F^k UFIR(n-k) exactly."""
    trial = short_trial(np.random.default_rng(3))
    late = [[] if n < 2 else [(n - 2, 2)] for n in range(150)]
    delayed = estimate(Contender("", 6), trial, late)
    from ufirext import UFIRFilter

    f = UFIRFilter(4, 2, horizon=6)
    model = trial.models[0]
    f.F, f.H, f.Q, f.R = model.F, model.H, model.Q, model.R
    for n in range(148):
        f.predict()
        f.update(trial.measured[n].reshape(2, 1))
        if n >= 20:
            ahead = model.F @ model.F @ f.x
            np.testing.assert_allclose(delayed[n + 2], ahead[::2, 0], atol=1e-6)


def test_dropped_packets_are_not_seen_and_late_ones_as_new_are() -> None:
    trial = short_trial(np.random.default_rng(4))
    late = [[] if n < 1 else [(n - 1, 1)] for n in range(150)]
    dropped = estimate(Contender("", None, late="dropped"), trial, late)
    np.testing.assert_allclose(dropped, np.broadcast_to(trial.measured[0], dropped.shape))
    as_new = estimate(KALMAN, trial, late)
    on_time = estimate(KALMAN, trial, [[(n, 0)] for n in range(150)])
    np.testing.assert_allclose(as_new[80:], on_time[79:-1], atol=1e-3)


def test_the_tuned_density_beats_its_neighbours_on_the_drive_it_was_tuned_on() -> None:
    def trial_of(q: float) -> Trial:
        return short_trial(np.random.default_rng(5), q)

    perfect = transmit(np.random.default_rng(0), 150, Link())
    best = tuned_density(trial_of)
    error = {
        f: rmse(estimate(KALMAN, trial_of(f * best), perfect), trial_of(1.0).drive.position)
        for f in (0.5, 1.0, 2.0)
    }
    assert error[1.0] == min(error.values())


def test_scores_are_means_over_runs_with_their_standard_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    values = iter([2.0, 4.0, 9.0])
    monkeypatch.setattr("ufirext.demo.compare.CONTENDERS", (KALMAN,))
    monkeypatch.setattr("ufirext.demo.compare.SCENARIOS", {"on time": Link()})
    monkeypatch.setattr("ufirext.demo.compare.rmse", lambda *_: next(values))
    ticks: list[None] = []
    scores = compare(short_trial, np.random.default_rng(0), 3, lambda: ticks.append(None))
    score = scores["KalmanFilter"]["on time"]
    assert score.rmse == pytest.approx(5.0)
    assert score.error == pytest.approx(np.std([2.0, 4.0, 9.0], ddof=1) / np.sqrt(3))
    assert len(ticks) == 3


def test_one_run_scores_every_filter_in_every_scenario_and_knowing_delays_pays() -> None:
    """On 600 steps: UFIR told the delays errs less than Kalman that takes late packets as new."""
    scores = compare(lambda rng: short_trial(rng, steps=600), np.random.default_rng(6), 1)
    assert set(scores) == {contender.name for contender in CONTENDERS}
    late = "10 % lost, 40 % late"
    for name, row in scores.items():
        assert set(row) == ({late} if "dropped" in name else set(SCENARIOS))
        assert all(np.isfinite(score.rmse) for score in row.values())
    assert scores["UFIR auto, right Q, R"][late].rmse < scores["Kalman, right Q, R"][late].rmse


def test_equal_steps_share_a_model_and_others_do_not() -> None:
    shared = models(np.array([0.0, 1.0, 2.0, 4.0]), 1.0, 1.0)
    assert shared[0] is shared[1] is shared[2]
    assert shared[3].F[0, 1] == 2.0


def write(path: Path, seconds: np.ndarray, truth: bool = False, header: str = "t_s,east_m,north_m") -> Path:
    rows = [f"{t:.3f},{5 * t:.3f},{np.sin(t / 9):.3f}" for t in seconds.tolist()]
    if truth:
        header += ",truth_east_m,truth_north_m"
        rows = [
            f"{row},{5 * t + 2:.3f},{np.sin(t / 9):.3f}"
            for row, t in zip(rows, seconds.tolist(), strict=True)
        ]
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


def test_a_file_without_truth_is_truth_and_gets_noise(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    scene = recorded(write(tmp_path / "track.csv", np.arange(400.0)), rng, noise=2.0)
    trial = scene.trial(rng)
    np.testing.assert_allclose(trial.drive.position[:, 0], 5 * trial.drive.seconds, atol=1e-9)
    residual = trial.measured - trial.drive.position
    assert residual.std() == pytest.approx(2.0, rel=5 / np.sqrt(2 * residual.size))
    assert any("taken as truth" in note for note in scene.notes)


def test_a_file_with_truth_is_measured_as_recorded(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    scene = recorded(write(tmp_path / "track.csv", np.arange(150.0), truth=True), rng, noise=2.0)
    trial = scene.trial(rng)
    np.testing.assert_allclose(
        trial.drive.position - trial.measured, np.tile([2.0, 0.0], (150, 1)), atol=1e-9
    )
    assert trial.models[0].R[0, 0] == pytest.approx(2.0)  # mean over both axes of 2^2 and 0


def test_the_longest_stretch_without_a_gap_is_used(tmp_path: Path) -> None:
    seconds = np.concatenate([np.arange(50.0), 100 + np.arange(130.0), 400 + np.arange(40.0)])
    rng = np.random.default_rng(0)
    trial = recorded(write(tmp_path / "track.csv", seconds), rng, noise=1.0).trial(rng)
    assert len(trial.drive) == 130
    assert trial.drive.position[0, 0] == pytest.approx(500.0)


def test_a_long_file_is_cut(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    scene = recorded(write(tmp_path / "track.csv", np.arange(LONGEST + 500.0)), rng, noise=1.0)
    assert len(scene.trial(rng).drive) == LONGEST


def test_long_and_irregular_files_get_fewer_runs(tmp_path: Path) -> None:
    regular, jittered = np.arange(600.0), np.arange(600.0) + 0.1 * (np.arange(600) % 2)
    scenes = [
        recorded(write(tmp_path / "track.csv", seconds), np.random.default_rng(0), noise=1.0)
        for seconds in (regular[:300], regular, jittered)
    ]
    assert [scene.runs for scene in scenes] == [20, 20, 5]


def test_too_short_a_file_is_an_error_with_its_length(tmp_path: Path) -> None:
    with pytest.raises(UfirextError, match="has 60 rows; the demo needs 100"):
        recorded(write(tmp_path / "track.csv", np.arange(60.0)), np.random.default_rng(0), noise=1.0)


def test_every_city_trial_is_another_drive_with_noise_of_the_given_size() -> None:
    rng = np.random.default_rng(0)
    scene = city(rng, 4.0)
    first, second = scene.trial(rng), scene.trial(rng)
    assert isinstance(first.drive, Drive)
    assert not np.allclose(first.drive.position, second.drive.position)
    residual = first.measured - first.drive.position
    assert residual.std() == pytest.approx(4.0, rel=5 / np.sqrt(2 * residual.size))
