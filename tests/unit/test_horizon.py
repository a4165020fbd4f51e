"""best_horizon and the bank: arguments, errors, edge cases."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest

from ufirext import (
    HorizonError,
    Model,
    NonFiniteError,
    ShapeError,
    UnobservableWindow,
    best_horizon,
    kinematic,
)
from ufirext.adaptive import BANK, HorizonBank, bank_candidates
from ufirext.horizon import check_horizon, shortest_horizon

RAMP = kinematic(1, 1, 1.0, q=0.01, r=1.0)


def ramp_data(steps: int = 200, seed: int = 0) -> np.ndarray:
    return 0.3 * np.arange(steps) + np.random.default_rng(seed).normal(size=steps)


@pytest.mark.parametrize("shape", [(200,), (200, 1), (200, 1, 1)])
def test_a_series_comes_in_the_usual_shapes(shape):
    assert best_horizon(RAMP, ramp_data().reshape(shape)) == best_horizon(RAMP, ramp_data())
    assert best_horizon(RAMP, ramp_data().tolist()) == best_horizon(RAMP, ramp_data())


def test_a_straight_line_deserves_a_long_window():
    assert best_horizon(RAMP, ramp_data(400)) > 60


@pytest.mark.parametrize("bad", [np.ones((20, 2)), np.ones((2, 20, 3)), np.float64(3.0), [["a"]]])
def test_a_series_of_another_shape_is_refused(bad):
    with pytest.raises(ShapeError, match="zs must"):
        best_horizon(RAMP, bad)


def test_an_infinity_is_refused_with_its_step():
    zs = ramp_data()
    zs[17] = -np.inf
    with pytest.raises(NonFiniteError, match=r"zs must be finite or NaN .* infinity at step 17"):
        best_horizon(RAMP, zs)


@pytest.mark.parametrize("zs", [[], [1.0], np.ones(7), np.full(50, np.nan)])
def test_too_short_a_series_says_how_many_it_needs(zs):
    with pytest.raises(ShapeError, match="zs must hold at least 8 measurements"):
        best_horizon(RAMP, zs)


def test_the_shortest_series_that_is_accepted():
    assert best_horizon(RAMP, ramp_data(8)) == 4


def test_measurements_too_far_apart_to_predict_anything_are_refused():
    zs = np.full(400, np.nan)
    zs[::50] = 1.0
    with pytest.raises(ShapeError, match="close enough together"):
        best_horizon(RAMP, zs, longest=10)


def test_missing_components_are_left_out_each_for_itself():
    """Two axes that are never measured together still choose a horizon."""
    model = kinematic(1, 2, 1.0, q=0.01, r=1.0)
    zs = np.column_stack([ramp_data(400, 1), ramp_data(400, 2)])
    zs[::2, 0] = np.nan
    zs[1::2, 1] = np.nan
    assert 4 <= best_horizon(model, zs) <= 200


def test_masked_measurements_are_missing():
    zs = np.ma.array(ramp_data(400), mask=np.arange(400) % 3 == 0)
    assert best_horizon(RAMP, zs) == best_horizon(RAMP, zs.filled(np.nan)) != best_horizon(RAMP, zs.filled(0))
    bank, twin = HorizonBank((4, 8, 16)), HorizonBank((4, 8, 16))
    for _ in range(20):
        bank.score(np.ma.array([3.0, 2.0, 0.0], mask=[0, 0, 1]))
        twin.score([3.0, 2.0, np.nan])
    assert bank.best == twin.best == 8


def test_with_correlated_noise_a_broken_row_is_left_out_whole():
    model = kinematic(1, 2, 1.0, q=0.01).replace(R=[[1.0, 0.5], [0.5, 1.0]])
    zs = np.column_stack([ramp_data(400, 1), ramp_data(400, 2)])
    zs[::7, 0] = np.nan
    whole = zs.copy()
    whole[::7] = np.nan
    assert best_horizon(model, zs) == best_horizon(model, whole)


@pytest.mark.parametrize("longest", [3, 0, 10.0, None])
def test_a_cap_below_the_floor_is_refused(longest):
    with pytest.raises(HorizonError, match=r"longest must be .*the shortest horizon to choose from is 4"):
        best_horizon(RAMP, longest=longest)


def test_the_cap_holds_for_models_and_data():
    still = kinematic(1, 1, 1.0, q=0.0)
    assert best_horizon(still, longest=12) == 12
    assert best_horizon(still, ramp_data(400), longest=12) <= 12


def test_an_unobservable_model_has_no_horizon():
    unseen = Model(np.eye(2), [[1.0, 0.0]])
    for call in (
        best_horizon,
        shortest_horizon,
        lambda m: best_horizon(m, ramp_data()),
        lambda m: check_horizon(9, m),
    ):
        with pytest.raises(UnobservableWindow, match="no horizon determines all 2 states") as caught:
            call(unseen)
        assert caught.value.shortest is None


@pytest.mark.parametrize("R", [0.0, np.diag([1.0, 0.0]), np.ones((2, 2))])
def test_a_singular_measurement_noise_is_handled(R):
    model = kinematic(1, 2, 1.0, q=0.01).replace(R=R)
    assert 4 <= best_horizon(model) <= 200
    assert 4 <= best_horizon(model, np.column_stack([ramp_data(), ramp_data(seed=1)])) <= 200


def test_a_model_without_any_noise_takes_the_shortest():
    assert best_horizon(kinematic(1, 1, 1.0, q=0.0, r=0.0)) == 4


def test_an_unstable_and_a_singular_model_have_a_horizon():
    assert 3 <= best_horizon(Model([[1.3]], [[1.0]], Q=0.1)) <= 200
    chain = Model(
        [[1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]], Q=np.diag([0, 0.1, 0])
    )
    assert shortest_horizon(chain) == 3
    assert 5 <= best_horizon(chain) <= 200


def test_check_horizon_names_the_shortest():
    assert check_horizon(np.int32(2), RAMP) == 2
    with pytest.raises(
        UnobservableWindow, match=r"horizon must be at least 2 .* got 1: lengthen the horizon"
    ) as caught:
        check_horizon(1, RAMP)
    assert caught.value.shortest == 2
    for bad in (2.5, "auto", None, 0):
        with pytest.raises(HorizonError, match="the shortest horizon that works is 2"):
            check_horizon(bad, RAMP)


# -- the bank


def test_candidates_have_a_row_to_spare():
    assert bank_candidates(1) == BANK
    assert bank_candidates(3)[0] == 4
    assert bank_candidates(20)[0] == 21
    assert list(bank_candidates(20)) == sorted(set(bank_candidates(20)))


@pytest.mark.parametrize("candidates", [(), (5, 4), (4, 4, 8), (0, 3), (3.0, 4)])
def test_candidates_must_ascend(candidates):
    with pytest.raises(HorizonError, match="candidates must be"):
        HorizonBank(candidates)


@pytest.mark.parametrize("forgetting", [0.0, 1.0, -0.5, 2.0, np.nan])
def test_forgetting_lies_between_nothing_and_everything(forgetting):
    with pytest.raises(HorizonError, match="forgetting must lie between 0 and 1"):
        HorizonBank((3, 4), forgetting)


def test_forgetting_is_a_number():
    with pytest.raises(ShapeError, match=r"forgetting must be a number, got '0\.9'"):
        HorizonBank((3, 4), "0.9")


def test_without_evidence_the_middle_candidate_stays():
    bank = HorizonBank((3, 5, 9))
    assert bank.best == 5
    bank.score([0.0, 1.0, 1.0])
    assert bank.best == 5
    assert np.isnan(HorizonBank((3, 5, 9)).scores()).all()


def test_ties_do_not_change_the_choice():
    bank = HorizonBank((3, 5, 9))
    for _ in range(500):
        bank.score([1.0, 1.0, 1.0])
    assert bank.best == 5
    for _ in range(500):
        bank.score([1.0, 1.0, 0.99])
    assert bank.best == 5


def test_a_candidate_that_cannot_predict_does_not_compete():
    bank = HorizonBank((3, 5, 9))
    for _ in range(100):
        bank.score([2.0, 1.0, np.nan])
    assert bank.best == 5
    np.testing.assert_allclose(bank.scores()[:2], [2.0, 1.0])
    assert np.isnan(bank.scores()[2])
    for _ in range(50):
        bank.score([2.0, 1.0, 0.1])
    assert bank.best == 9


def test_a_row_nobody_predicted_leaves_the_bank_alone():
    bank = HorizonBank((3, 5))
    for _ in range(20):
        bank.score([1.0, 2.0])
    before = bank.scores()
    bank.score([np.nan, np.nan])
    np.testing.assert_array_equal(bank.scores(), before)


def test_scores_are_exponentially_forgotten_means():
    bank = HorizonBank((3,), forgetting=0.5)
    for error in (1.0, 2.0, 4.0):
        bank.score([error])
    assert bank.scores()[0] == pytest.approx((4 + 0.5 * 2 + 0.25 * 1) / 1.75)


def test_errors_of_another_count_are_refused():
    with pytest.raises(ShapeError, match=r"errors must have shape \(2,\).*got \(3,\)"):
        HorizonBank((3, 4)).score([1.0, 2.0, 3.0])


@pytest.mark.parametrize("copied", [HorizonBank.copy, copy.deepcopy, lambda b: pickle.loads(pickle.dumps(b))])
def test_copies_go_their_own_way(copied):
    bank = HorizonBank((3, 5, 9), 0.9)
    for _ in range(30):
        bank.score([2.0, 1.0, 1.5])
    twin = copied(bank)
    for _ in range(60):
        twin.score([0.0, 1.0, 1.5])
    assert (bank.best, twin.best) == (5, 3)
    assert (twin.candidates, twin.forgetting) == (bank.candidates, bank.forgetting)
