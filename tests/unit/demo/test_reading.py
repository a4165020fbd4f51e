"""The note under the table follows from the table."""

from __future__ import annotations

import pytest

pytest.importorskip("pandas", reason="pip install ufirext[cli]")

import numpy as np

from ufirext.demo.compare import CONTENDERS, DENSITIES, SCENARIOS, Score, models, tuned_density
from ufirext.demo.reading import reading
from ufirext.demo.scene import recorded

from .test_compare import Drive, Path, Trial, write


def table(**special: tuple[float, float]) -> dict[str, dict[str, Score]]:
    """Every score 5 ± 0.1, those of the right Q and R 4 ± 0.1, but for what is said of a filter."""
    rows = {c.name: (4.0 if c.name.endswith("right Q, R") else 5.0, 0.1) for c in CONTENDERS}
    rows |= {name.replace("_", " "): score for name, score in special.items()}
    return {name: dict.fromkeys(SCENARIOS, Score(*score)) for name, score in rows.items()}


@pytest.mark.parametrize("margin", [0.0, 0.1])
def test_a_kalman_filter_that_nothing_beats_is_the_yardstick(margin: float) -> None:
    note = reading(table(**{"UFIR adaptive, no Q, no R": (4.0 - margin, 0.1)}))[1]
    assert "nothing beats the Kalman filter with the right Q and R" in note


def test_who_beats_it_is_named_with_both_errors() -> None:
    note = reading(table(**{"H-infinity, Q / 100 (or R x 100)": (3.5, 0.1)}))[1]
    assert "nothing beats" not in note
    for scenario in SCENARIOS:
        assert f"{scenario}, H-infinity, Q / 100 (or R x 100) (3.50 m against 4.00 m)" in note


def test_one_run_has_no_standard_error_and_the_note_says_who_is_better() -> None:
    nan = float("nan")
    scores = {name: {s: Score(score.rmse, nan) for s, score in row.items()} for name, row in table().items()}
    assert "nothing beats" in reading(scores)[1]
    scores["UFIR auto, right Q, R"] = dict.fromkeys(SCENARIOS, Score(3.9, nan))
    assert "UFIR auto, right Q, R (3.90 m against 4.00 m)" in reading(scores)[1]


def test_a_search_that_ends_at_its_edge_says_so(tmp_path: Path) -> None:
    """Somebody who stands: the less process noise, the better."""
    seconds = np.arange(150.0)
    still = Trial(Drive(seconds, np.zeros((150, 2))), np.random.default_rng(0).standard_normal((150, 2)), [])
    found = tuned_density(lambda q: Trial(still.drive, still.measured, models(seconds, q, 1.0)))
    assert found == pytest.approx(DENSITIES[0])
    path = write(tmp_path / "still.csv", seconds)
    path.write_text("t_s,east_m,north_m\n" + "".join(f"{t},0,0\n" for t in range(150)), encoding="utf-8")
    notes = recorded(path, np.random.default_rng(0), noise=1.0).notes
    assert any("ended there, at its edge: less may be better" in note for note in notes)
