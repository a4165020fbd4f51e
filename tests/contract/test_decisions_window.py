"""The decisions WARM-UP, WINDOW, P, R and missing: which rows x is the least-squares estimate of."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from ufirext import HorizonError, UfirextError, UFIRFilter

from .models import constant_velocity, flat, plane, run, vector, walk
from .naive import BookKalman, Row, extended, window_estimate

INSTANTS = 4  # nu + 2 of the constant-velocity models


def rows_of(f, zs, first=1):
    """The rows that arrive when ``run(f, zs)`` starts with step ``first``."""
    return [
        Row(n, np.atleast_1d(z), f.H.copy(), f.R.copy()) for n, z in enumerate(zs, first) if z is not None
    ]


def acceleration(ufir, column, **more):
    f = ufir(3, 1, **more)
    f.x = vector([1.0, 2.0, 3.0], column)
    f.P = np.diag([9.0, 4.0, 1.0])
    f.F = np.array([[1.0, 1.0, 0.5], [0.0, 1.0, 1.0], [0.0, 0.0, 1.0]])
    f.H = np.array([[1.0, 0.0, 0.0]])
    f.Q = 0.1 * np.eye(3)
    f.R = np.array([[2.0]])
    return f


@pytest.mark.contract("WARM-UP")
def test_until_the_rows_determine_the_state_it_is_the_books_kalman_filter(ufir, column, rng):
    f = acceleration(ufir, column)
    book = BookKalman(flat(f.x), f.P.copy())
    for n, z in enumerate([None, *walk(rng, 2, 1), None, None, *walk(rng, 1, 1)]):
        f.predict()
        book.predict(f.F, f.Q)
        np.testing.assert_allclose(flat(f.x), book.x, rtol=1e-10)
        np.testing.assert_allclose(f.P, book.P, rtol=1e-10)
        f.update(z)
        if n == 5:
            break
        if z is not None:
            book.update(z, f.H, f.R)
        assert not f.ready
        np.testing.assert_allclose(flat(f.x), book.x, rtol=1e-10)
        np.testing.assert_allclose(f.P, book.P, rtol=1e-10)
    assert f.ready


@pytest.mark.contract("WARM-UP")
def test_from_then_on_it_is_least_squares_over_the_growing_and_then_the_sliding_window(ufir, column, rng):
    """And P is the exact error covariance of that estimate, prior and posterior."""
    f = acceleration(ufir, column)
    zs = walk(rng, 50, 1)
    rows = rows_of(f, zs)
    for n, z in enumerate(zs, 1):
        run(f, [z])
        assert f.ready == (n >= 3)
        if f.ready:
            inside = [row for row in rows if n - ufir.horizon < row.origin <= n]
            x, P = window_estimate(inside, f.F, f.Q, n)
            np.testing.assert_allclose(flat(f.x), x, rtol=1e-8, atol=1e-8)
            np.testing.assert_allclose(f.P, P, rtol=1e-7, atol=1e-8)
            assert f.rows == len(inside) == min(n, ufir.horizon)


@pytest.mark.contract("WARM-UP")
def test_once_ready_x0_P0_and_Q_no_longer_matter(ufir, column, rng):
    f, twin = plane(ufir, column), plane(ufir, column, x0=(1e3, -50, 7, 70), q=25.0)
    twin.P = np.diag([1e-3, 1e6, 1.0, 1e-6])
    for z in walk(rng, 60, 2):
        run(f, [z])
        run(twin, [z])
        assert f.ready == twin.ready
        if f.ready:
            np.testing.assert_allclose(f.x, twin.x, rtol=1e-8, atol=1e-7)
    assert f.ready


@pytest.mark.contract("WARM-UP")
@pytest.mark.parametrize("missing", ["extend", "skip"])
def test_when_losses_have_emptied_the_window_it_coasts_and_starts_again_the_same_way(
    ufir, column, rng, missing
):
    f = plane(ufir, column, missing=missing)
    run(f, walk(rng, 60, 2))
    if missing == "skip":
        run(f, [None] * ufir.horizon)
    book = BookKalman(flat(f.x), f.P.copy())
    for _ in range(4 * ufir.horizon + 70):
        run(f, [None])
        book.predict(f.F, f.Q)
        np.testing.assert_allclose(flat(f.x), book.x, rtol=1e-9)
        np.testing.assert_allclose(f.P, book.P, rtol=1e-7)
    assert not f.ready

    zs = walk(rng, 3, 2)
    run(f, zs[:1])
    book.predict(f.F, f.Q)
    book.update(zs[0], f.H, f.R)
    np.testing.assert_allclose(flat(f.x), book.x, rtol=1e-6, atol=1e-6)
    assert not f.ready
    run(f, zs[1:])
    assert f.ready
    np.testing.assert_allclose(
        flat(f.x), window_estimate(rows_of(f, zs), f.F, f.Q, 3)[0], rtol=1e-8, atol=1e-8
    )


@pytest.mark.contract("WINDOW")
def test_with_extend_the_window_moves_when_a_row_arrives(ufir, column, rng):
    """At least min(N, nu + 2) instants, reached back for; the prior in between."""
    f = plane(ufir, column)
    zs = [z if n < 12 or n % 3 == 0 or n > 60 else None for n, z in enumerate(walk(rng, 80, 2))]
    zs[30:48] = [None] * 18
    rows = rows_of(f, zs)
    for n, z in enumerate(zs, 1):
        run(f, [z])
        if z is None:
            np.testing.assert_array_equal(f.x, f.x_prior)
        elif n > 1:
            chosen = extended(
                [row for row in rows if row.origin <= n], n, ufir.horizon, min(ufir.horizon, INSTANTS)
            )
            x, P = window_estimate(chosen, f.F, f.Q, n)
            np.testing.assert_allclose(flat(f.x), x, rtol=1e-8, atol=1e-8)
            np.testing.assert_allclose(f.P, P, rtol=1e-7, atol=1e-8)


@pytest.mark.contract("WINDOW")
@pytest.mark.parametrize("how", ["None", "nan", "zero H", "1e-10 of the weight"])
def test_what_brings_no_row_leaves_x_and_P_at_the_prior(ufir, column, rng, how):
    f, twin = plane(ufir, column), plane(ufir, column)
    for n, z in enumerate(walk(rng, 60, 2)):
        f.predict()
        twin.predict()
        if n % 5 != 3:
            f.update(z)
            twin.update(z)
            np.testing.assert_allclose(f.x, twin.x, rtol=1e-12)
            continue
        if how == "None":
            f.update(None)
        elif how == "nan":
            f.update([np.nan, np.nan])
        elif how == "zero H":
            f.update(vector([1e3, 1e3], column), None, np.zeros((2, 4)))
        else:
            f.update([1e3, 1e3], R=1e10 * f.R)
        twin.update(None)
        np.testing.assert_array_equal(f.x, f.x_prior)
        np.testing.assert_array_equal(f.P, f.P_prior)
    assert f.rows == twin.rows


@pytest.mark.contract("missing")
def test_with_skip_the_window_moves_at_every_update(ufir, column, rng):
    f = constant_velocity(ufir, column, missing="skip")
    zs = [None if n % 4 == 1 else z for n, z in enumerate(walk(rng, 60, 1))]
    rows = rows_of(f, zs)
    for n, z in enumerate(zs, 1):
        run(f, [z])
        inside = [row for row in rows if n - ufir.horizon < row.origin <= n]
        if len(inside) > 1:
            assert f.ready
            np.testing.assert_allclose(
                flat(f.x), window_estimate(inside, f.F, f.Q, n)[0], rtol=1e-8, atol=1e-8
            )


@pytest.mark.contract("missing")
def test_with_predict_a_lost_datum_is_replaced_by_the_filters_own_prediction(ufir, column, rng):
    f = constant_velocity(ufir, column, missing="predict")
    rows = []
    for n, z in enumerate(walk(rng, 60, 1), 1):
        f.predict()
        lost = n > 5 and n % 6 == 0
        datum = f.H @ flat(f.x_prior) if lost else z
        rows.append(Row(n, datum, f.H.copy(), f.R.copy()))
        f.update(None if lost else z)
        if n > 1 and not lost:
            inside = [row for row in rows if row.origin > n - ufir.horizon]
            np.testing.assert_allclose(
                flat(f.x), window_estimate(inside, f.F, f.Q, n)[0], rtol=1e-8, atol=1e-8
            )


@pytest.mark.contract("missing")
def test_other_words_for_missing_and_window_are_refused(ufir):
    with pytest.raises(ValueError, match=r"missing.*extend.*skip.*predict.*got 'drop'"):
        ufir(2, 1, missing="drop")
    with pytest.raises(ValueError, match=r"window.*arrivals.*origins.*got 'both'"):
        ufir(2, 1, window="both")


@pytest.mark.contract("WINDOW")
def test_several_updates_in_one_step_are_several_rows(ufir, column, rng):
    f = constant_velocity(ufir, column)
    rows = []
    for n in range(1, 60):
        f.predict()
        for _ in range(1 + n % 3):
            R = np.array([[rng.uniform(0.5, 4.0)]])
            rows.append(Row(n, n + rng.standard_normal(1), f.H.copy(), R))
            f.update(rows[-1].z, R=R)
        if n > 1:
            inside = [row for row in rows if row.origin > n - ufir.horizon]
            x, P = window_estimate(inside, f.F, f.Q, n)
            np.testing.assert_allclose(flat(f.x), x, rtol=1e-8, atol=1e-8)
            np.testing.assert_allclose(f.P, P, rtol=1e-7, atol=1e-8)


@pytest.mark.contract("WINDOW")
def test_any_number_of_updates_in_one_step_takes_bounded_memory(ufir, column):
    f, twin = constant_velocity(ufir, column), constant_velocity(ufir, column)
    run(f, range(10))
    run(twin, range(10))
    for _ in range(8):
        twin.update(9.0)
    for _ in range(300):
        f.update(9.0)
    assert len(pickle.dumps(f)) < 1.2 * len(pickle.dumps(twin)) + 100


@pytest.mark.contract("R")
@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_once_ready_the_common_scale_of_R_cannot_change_x(ufir, column, rng, scale):
    f, twin = plane(ufir, column), plane(ufir, column)
    twin.R = scale * twin.R
    for n, z in enumerate(walk(rng, 60, 2)):
        f.predict()
        twin.predict()
        f.update(z, R=f.R * (1 + n % 3))
        twin.update(z, R=twin.R * (1 + n % 3))
        if n:
            np.testing.assert_allclose(f.x, twin.x, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"missing": "drop"}, "missing must be one of 'extend', 'skip', 'predict', got 'drop'"),
        ({"missing": np.array(["extend", "skip"])}, "missing must be one of 'extend'"),
        ({"window": np.array(["arrivals", "origins"])}, "window must be one of 'arrivals'"),
        ({"horizon": np.array([5, 6])}, r"horizon must be an integer, got array\(\[5, 6\]\)"),
        ({"horizon": np.array(["auto", "auto"])}, "horizon must be an integer, got array"),
        ({"horizon": -(10**5000)}, "horizon must be at least 1, got an int of 16610 bits"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(UfirextError, match=message):
        UFIRFilter(2, 1, **options)


@pytest.mark.parametrize("missing", ["extend", "skip", "predict"])
@pytest.mark.parametrize("horizon", [10**13, 10**20, 10**400], ids=["long", "longer", "longest"])
def test_a_window_beyond_any_memory_is_refused_with_its_size(horizon, missing):
    with pytest.raises(HorizonError, match=r"horizon must be a window that fits into memory, got .* GiB"):
        UFIRFilter(2, 1, horizon=horizon, missing=missing)
    f = constant_velocity(UFIRFilter, horizon=5, missing=missing)
    twin = constant_velocity(UFIRFilter, horizon=5, missing=missing)
    for n in range(20):
        if n in (0, 3, 12):
            with pytest.raises(HorizonError, match="fits into memory"):
                f.horizon = horizon
        run(f, [float(n)])
        run(twin, [float(n)])
        np.testing.assert_array_equal(f.x, twin.x)
    assert f.horizon == 5
