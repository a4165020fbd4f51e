"""H: whole series, and filterpy's Saver."""

from __future__ import annotations

from itertools import repeat

import numpy as np
import pytest
from filterpy.common import Saver
from filterpy.kalman import KalmanFilter

from ufirext import ShapeError

from .models import constant_velocity, flat, plane, ramp_F, run, vector, walk


def series(rng, steps=60):
    """Measurements of the plane with losses, the first among them."""
    return [None if n % 7 == 0 or 20 <= n < 26 else list(z) for n, z in enumerate(walk(rng, steps, 2))]


def hand_loop(f, zs, update_first=False):
    posterior, prior = [], []
    for z in zs:
        if update_first:
            f.update(z)
            posterior.append((f.x.copy(), f.P.copy()))
        f.predict()
        prior.append((f.x.copy(), f.P.copy()))
        if not update_first:
            f.update(z)
            posterior.append((f.x.copy(), f.P.copy()))
    pairs = (zip(*posterior, strict=True), zip(*prior, strict=True))
    return tuple(np.array(values) for pair in pairs for values in pair)


def assert_batches_equal(one, other, tolerance=1e-9):
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(a, b, rtol=tolerance, atol=tolerance)


@pytest.mark.contract(53)
def test_batch_filter_returns_arrays_of_filterpys_shapes(make, column):
    f = constant_velocity(make, column)
    means, covariances, prior_means, prior_covariances = f.batch_filter([1.0, 2.0, None, 4.0, 5.0])
    assert means.shape == prior_means.shape == ((5, 2, 1) if column else (5, 2))
    assert covariances.shape == prior_covariances.shape == (5, 2, 2)


@pytest.mark.contract(53)
def test_a_batch_of_nothing(make, column):
    f = constant_velocity(make, column)
    assert [len(array) for array in f.batch_filter([])] == [0, 0, 0, 0]


@pytest.mark.contract(54)
def test_a_batch_is_the_hand_loop_and_so_is_the_next(make, column, rng):
    f, twin = constant_velocity(make, column), constant_velocity(make, column)
    zs = [None if n % 7 == 0 else z[0] for n, z in enumerate(walk(rng, 90, 1))]
    for part in (zs[:60], zs[60:]):
        assert_batches_equal(f.batch_filter(part), hand_loop(twin, part))
        np.testing.assert_allclose(f.x, twin.x, rtol=1e-9)
    run(f, zs[:5])
    run(twin, zs[:5])
    np.testing.assert_allclose(f.x, twin.x, rtol=1e-9)


@pytest.mark.contract(55)
def test_update_first(make, column, rng):
    f, twin = constant_velocity(make, column), constant_velocity(make, column)
    zs = [None if n % 7 == 2 else z[0] for n, z in enumerate(walk(rng, 60, 1))]
    assert_batches_equal(f.batch_filter(zs, update_first=True), hand_loop(twin, zs, update_first=True))


@pytest.mark.contract(56)
def test_lists_of_matrices_and_inputs(make, column, rng):
    n, zs = 60, [vector(z, column) for z in walk(rng, 60, 1)]
    zs[7] = None
    Fs = [ramp_F(0.5 + 0.1 * (i % 4)) for i in range(n)]
    Qs = [(0.1 + 0.01 * i) * np.eye(2) for i in range(n)]
    Hs = [np.array([[1.0, 0.1 * (i % 2)]]) for i in range(n)]
    Rs = [np.array([[1.0 + i % 3]]) for i in range(n)]
    Bs = [np.array([[0.5], [1.0 + 0.1 * i]]) for i in range(n)]
    us = [vector([np.sin(i)], column) for i in range(n)]
    f, twin = constant_velocity(make, column), constant_velocity(make, column)
    result = f.batch_filter(zs, Fs, Qs, Hs, Rs, Bs, us)
    expected = []
    for i in range(n):
        twin.predict(us[i], Bs[i], Fs[i], Qs[i])
        prior = twin.x.copy(), twin.P.copy()
        twin.update(zs[i], Rs[i], Hs[i])
        expected.append((twin.x.copy(), twin.P.copy(), *prior))
    assert_batches_equal(result, [np.array(column_of) for column_of in zip(*expected, strict=True)])
    np.testing.assert_array_equal(f.F, ramp_F())


@pytest.mark.contract(56)
@pytest.mark.parametrize("given", ["Fs", "Qs", "Rs", "Hs"])
def test_a_list_of_the_filters_own_matrices_changes_nothing(make, column, rng, given):
    f, twin = constant_velocity(make, column), constant_velocity(make, column)
    zs = [vector(z, column) for z in walk(rng, 60, 1)]
    own = getattr(f, given[0])
    assert_batches_equal(f.batch_filter(zs, **{given: [own.copy() for _ in zs]}), twin.batch_filter(zs))


@pytest.mark.contract(56, better=True)
@pytest.mark.parametrize("given", ["Fs", "Qs", "Hs", "Rs", "Bs", "us"])
@pytest.mark.parametrize("form", [list, iter], ids=["list", "iterator"])
@pytest.mark.parametrize("update_first", [False, True])
def test_a_list_shorter_than_the_series_is_refused_before_anything_is_filtered(
    make, given, form, update_first
):
    f, twin = (constant_velocity(make) for _ in range(2))
    with pytest.raises(ShapeError, match=rf"^{given} must hold one entry .* 4 .*, got 2$"):
        f.batch_filter([1.0, 2.0, 3.0, 4.0], **{given: form([None, None])}, update_first=update_first)
    assert_batches_equal(f.batch_filter([1.0, 2.0]), twin.batch_filter([1.0, 2.0]))


@pytest.mark.contract(56)
def test_a_list_may_go_on_after_the_series(make):
    f, twin = constant_velocity(make), constant_velocity(make)
    result = f.batch_filter([1.0, 2.0, 3.0], Fs=repeat(f.F), Qs=[f.Q] * 9)
    assert_batches_equal(result, twin.batch_filter([1.0, 2.0, 3.0]))


@pytest.mark.contract(56)
def test_B_without_inputs_is_no_input(make, rng):
    f, twin = constant_velocity(make), constant_velocity(make)
    f.B = np.array([[0.5], [1.0]])
    zs = [z[0] for z in walk(rng, 30, 1)]
    assert_batches_equal(f.batch_filter(zs), twin.batch_filter(zs))


@pytest.mark.contract(57, better=True)
@pytest.mark.parametrize(
    "form", [list, tuple, np.asarray, lambda z: np.reshape(z, (2, 1)), lambda z: np.reshape(z, (1, 2))]
)
def test_vector_measurements_of_any_form_with_either_form_of_x(make, column, rng, form):
    f, twin = plane(make, column), plane(make, column)
    zs = series(rng)
    result = f.batch_filter([None if z is None else form(z) for z in zs])
    assert result[0].shape == ((60, 4, 1) if column else (60, 4))
    assert_batches_equal(result, hand_loop(twin, zs))


@pytest.mark.contract(57, better=True)
@pytest.mark.parametrize("shape", [(60, 2), (60, 2, 1)])
def test_measurements_may_be_one_array_with_nan_for_what_is_missing(make, column, rng, shape):
    f, twin = plane(make, column), plane(make, column)
    zs = np.array([[np.nan] * 2 if z is None else z for z in series(rng)])
    result = f.batch_filter(zs.reshape(shape))
    assert_batches_equal(result, hand_loop(twin, [None if np.isnan(z).all() else z for z in zs]))


@pytest.mark.contract(58)
def test_a_saver_records_every_step_and_converts_every_attribute(make):
    f = constant_velocity(make)
    saver = Saver(f)
    zs = [None if n % 7 == 3 else np.array([[float(n)]]) for n in range(60)]
    means, covariances, *_ = f.batch_filter(zs, saver=saver)
    assert len(saver) == len(saver.x) == 60
    saver.to_array()
    for key in saver.keys:
        assert isinstance(getattr(saver, key), np.ndarray), key
        assert len(getattr(saver, key)) == 60, key
    np.testing.assert_array_equal(saver.x, means)
    np.testing.assert_array_equal(saver.P, covariances)
    assert saver.y.shape == (60, 1, 1)
    assert saver.likelihood.shape == (60,)
    saver.flatten()
    assert saver.x.shape == (60, 2)


@pytest.mark.contract(58, better=True)
def test_a_saver_converts_a_batch_of_scalars_with_losses(make, column):
    """In filterpy's batches z is what came: 3.0 in one step, a column of None in the next."""
    f = constant_velocity(make, column)
    saver = Saver(f)
    f.batch_filter([None if n % 7 == 3 else float(n) for n in range(60)], saver=saver)
    saver.to_array()
    assert saver.z.shape == ((60, 1, 1) if column else (60, 1))


@pytest.mark.contract(58, better=True)
def test_a_saver_converts_flat_states_with_losses_too(make):
    f = plane(make, column=False)
    saver = Saver(f)
    for z in [None, *([n, 2.0 * n] for n in range(60)), None]:
        f.predict()
        saver.save()
        f.update(z)
        saver.save()
    saver.to_array()
    assert saver.x.shape == (124, 4)
    assert saver.y.shape == saver.z.shape == (124, 2)


@pytest.mark.contract(58)
@pytest.mark.parametrize(
    "options", [{"skip_private": True}, {"skip_callable": True}, {"ignore": ("P", "likelihood")}]
)
def test_the_savers_options(make, options):
    f = constant_velocity(make)
    saver = Saver(f, **options)
    f.batch_filter([float(n) for n in range(20)], saver=saver)
    saver.to_array()
    assert saver.x.shape == (20, 2, 1)
    assert "P" in saver.keys or "P" in options.get("ignore", ())


@pytest.mark.contract(58)
def test_saving_changes_nothing(make, column, rng):
    f, twin = plane(make, column), plane(make, column)
    saver = Saver(f)
    for z in series(rng):
        run(f, [z])
        run(twin, [z])
        saver.save()
        np.testing.assert_array_equal(f.x, twin.x)
    np.testing.assert_array_equal(saver.x[-1], f.x)


@pytest.mark.contract(59)
def test_a_saver_before_the_first_step(make):
    f = plane(make)
    saver = Saver(f, save_current=True)
    for z in ([1.0, 2.0], [2.0, 3.0], None, [4.0, 5.0]):
        f.predict()
        saver.save()
        f.update(z)
        saver.save()
    saver.to_array()
    assert saver.x.shape == (9, 4, 1)
    assert saver.S.shape == (9, 2, 2)
    np.testing.assert_array_equal(saver.x[0], np.zeros((4, 1)))


@pytest.mark.contract(60)
def test_rts_smoother_is_finite_and_of_the_batchs_shapes(make, column, rng):
    """The Rauch-Tung-Striebel recursion over the means and covariances it is given."""
    f = constant_velocity(make, column)
    zs = [None if n % 7 == 3 else z[0] for n, z in enumerate(walk(rng, 60, 1))]
    means, covariances, *_ = f.batch_filter(zs)
    given = means.copy(), covariances.copy()
    x, P, K, P_prior = f.rts_smoother(means, covariances)
    assert (x.shape, P.shape, K.shape, P_prior.shape) == (means.shape, (60, 2, 2), (60, 2, 2), (60, 2, 2))
    assert all(np.isfinite(array).all() for array in (x, P, K, P_prior))
    np.testing.assert_array_equal(means, given[0])
    np.testing.assert_array_equal(covariances, given[1])
    np.testing.assert_array_equal(x[-1], means[-1])
    reference = constant_velocity(KalmanFilter, column).rts_smoother(*given)
    assert_batches_equal((x, P, K, P_prior), reference, 1e-6)


@pytest.mark.contract(60)
def test_rts_smoother_with_lists_of_matrices(make, column, rng):
    f = constant_velocity(make, column)
    means, covariances, *_ = f.batch_filter([z[0] for z in walk(rng, 40, 1)])
    lists = f.rts_smoother(means, covariances, Fs=[f.F] * 40, Qs=[f.Q] * 40, inv=np.linalg.pinv)
    assert_batches_equal(lists, f.rts_smoother(means, covariances), 1e-6)
    with pytest.raises(ValueError, match="length"):
        f.rts_smoother(means, covariances[:-1])


@pytest.mark.contract(60, better=True)
@pytest.mark.parametrize("given", ["Fs", "Qs"])
def test_rts_smoother_refuses_shorter_lists(make, given):
    f = constant_velocity(make)
    means, covariances, *_ = f.batch_filter([1.0, 2.0, 3.0])
    with pytest.raises(ShapeError, match=rf"^{given} must hold one entry .* 3 .*, got 2$"):
        f.rts_smoother(means, covariances, **{given: [np.eye(2)] * 2})


@pytest.mark.contract(54)
def test_a_batch_of_exact_data_ends_at_the_truth(make, column):
    f = plane(make, column, q=1e-3)
    zs = [vector([3.0 + 0.5 * n, -n], column) for n in range(60)]
    f.batch_filter(zs)
    np.testing.assert_allclose(flat(f.x), [32.5, 0.5, -59.0, -1.0], atol=1e-2)
