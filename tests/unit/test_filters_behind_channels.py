"""All four filters take every channel: what they accept, refuse, keep through copies, and never pay for."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from filterpy.common import Saver
from filterpy.kalman import KalmanFilter
from numpy.testing import assert_allclose

from tests.theory.delays import F1, H1, Q1, R1
from ufirext import DelayHInfinityFilter, DelayKalmanFilter, FMSFilterSmoother, UFIRFilter
from ufirext.channels import BernoulliDelay, Channel, CompensatedBernoulli, StampedLoss, TimeStamped
from ufirext.errors import HorizonError, UfirextError
from ufirext.filters._ufir_state import UFIRState

Maker = Callable[..., Any]


def ufir(**options: Any) -> Any:
    return UFIRFilter(2, 1, **({"horizon": 6} | options))


def adaptive(**options: Any) -> Any:
    return UFIRFilter(2, 1, horizon="adaptive", **options)


def fms(**options: Any) -> Any:
    return FMSFilterSmoother(2, 1, horizon=6, lag=2, **options)


def kalman(**options: Any) -> Any:
    return DelayKalmanFilter(2, 1, **options)


def hinfinity(**options: Any) -> Any:
    return DelayHInfinityFilter(2, 1, **options)


WINDOWED = (ufir, adaptive, fms)
FILTERS = (*WINDOWED, kalman, hinfinity)
CHANNELS = (
    TimeStamped(2, loss=0.2),
    StampedLoss(0.6, 0.8),
    BernoulliDelay(0.7),
    CompensatedBernoulli(0.6, 0.7),
)
every_filter = pytest.mark.parametrize("make", FILTERS, ids=lambda make: make.__name__)
windowed = pytest.mark.parametrize("make", WINDOWED, ids=lambda make: make.__name__)
every_channel = pytest.mark.parametrize("channel", CHANNELS, ids=lambda channel: type(channel).__name__)


def configured(make: Maker, **options: Any) -> Any:
    f = make(**options)
    f.F, f.H, f.Q, f.R, f.P = F1.copy(), H1.copy(), 0.05 * Q1, R1.copy(), 100.0 * np.eye(2)
    return f


def played(f: Any, channel: Channel, steps: int = 30, seed: int = 0) -> Any:
    arrivals = channel.sample(np.random.default_rng(seed), 2.0 * np.arange(1.0, steps + 1.0), R=R1)
    for packets in arrivals:
        f.predict()
        for packet in packets:
            f.update(packet.z, delay=packet.delay)
        if not packets:
            f.update(None)
    return f


@every_filter
@every_channel
def test_every_filter_follows_through_every_channel(make, channel):
    f = played(configured(make, channel=channel), channel, steps=60)
    assert f.channel == channel
    assert f.max_delay == channel.max_delay
    assert f.ready
    assert abs(f.x[0, 0] - 120.0) < 5.0 * np.sqrt(f.P[0, 0])
    assert np.linalg.eigvalsh(f.P)[0] > 0.0
    assert np.isfinite(f.log_likelihood)
    assert "object" in repr(f)


@every_filter
def test_max_delay_is_short_for_a_time_stamped_channel(make):
    short, long = (configured(make, **options) for options in ({"max_delay": 2}, {"channel": TimeStamped(2)}))
    assert short.channel == long.channel == TimeStamped(2)
    for f in (short, long):
        played(f, TimeStamped(2))
    assert np.array_equal(short.x, long.x)


@every_filter
@every_channel
@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda f: pickle.loads(pickle.dumps(f))])
def test_a_copy_goes_on_as_the_original_does(make, channel, duplicate):
    f = played(configured(make, channel=channel), channel, steps=25)
    g = duplicate(f)
    for each in (f, g):
        played(each, channel, steps=6, seed=1)
    assert_allclose(f.x, g.x, rtol=1e-10)
    assert_allclose(f.P, g.P, rtol=1e-10)
    assert g.channel == channel
    assert f.dropped == g.dropped


@every_filter
@every_channel
def test_a_batch_is_the_loop(make, channel):
    zs = [np.array([2.0 * n]) if n % 4 else None for n in range(25)]
    f, g = (configured(make, channel=channel) for _ in range(2))
    means, covs, *_ = f.batch_filter(zs)
    for n, z in enumerate(zs):
        g.predict()
        g.update(z)
        assert_allclose(means[n], g.x, atol=1e-9)
        assert_allclose(covs[n], g.P, atol=1e-9)


@pytest.mark.parametrize("kind", [UFIRFilter, FMSFilterSmoother, DelayKalmanFilter])
@every_channel
def test_a_filterpy_filter_goes_behind_a_channel(kind, channel):
    kf = KalmanFilter(2, 1)
    kf.F, kf.H, kf.Q, kf.R, kf.x = F1, H1, Q1, R1, np.array([[1.0], [2.0]])
    options = {} if kind is DelayKalmanFilter else {"horizon": 6}
    f = kind.from_filterpy(kf, channel=channel, **options)
    assert f.channel == channel
    assert_allclose(f.x, kf.x)


@windowed
@every_channel
def test_filterpys_saver_takes_it_down(make, channel):
    f = configured(make, channel=channel)
    saver = Saver(f)
    for n in range(6):
        f.predict()
        f.update(float(n))
        saver.save()
    saver.to_array()
    assert saver.x.shape == (6, 2, 1)
    assert saver.P.shape == (6, 2, 2)


@every_channel
def test_the_channel_stays_when_the_horizon_changes(channel):
    f = configured(ufir, channel=channel)
    for horizon in ("adaptive", 5, "auto", "adaptive", 8):
        f.horizon = horizon
        played(f, channel, steps=10)
        assert f.channel == channel
    assert f.ready


def test_the_horizon_may_change_while_sums_are_kept():
    f = configured(ufir)
    for n in range(30):
        if n % 10 == 9:
            f.horizon = {9: 5, 19: 9, 29: 4}[n]
        f.predict()
        f.update(2.0 * n, R=1.0 + n % 2, delay=0)
        f.update(2.0 * n - 2.0, delay=1)
    assert_allclose(f.x.ravel(), [58.0, 2.0], atol=1e-8)


def test_the_window_outlives_a_change_to_adaptive_behind_an_averaging_channel():
    f = played(configured(ufir, channel=BernoulliDelay(0.7)), BernoulliDelay(0.7))
    f.horizon = "adaptive"
    f.predict()
    f.update(2.0 * 31)
    assert f.ready
    assert abs(f.x[0, 0] - 62.0) < 15.0


# -- no price where there is no channel --------------------------------------------------


def test_without_a_channel_a_filter_is_what_it_was_and_any_delay_is_taken():
    f = configured(ufir)
    assert f.channel is None
    assert f.max_delay is None
    assert type(f._state) is UFIRState
    played(f, TimeStamped(0))
    f.predict()
    f.update(0.0, delay=40)
    f.update(0.0, delay=500)
    assert f.dropped == 1


@pytest.mark.parametrize("make", [ufir, fms])
def test_a_time_stamped_channel_leaves_the_hot_path_open(make):
    f = configured(make, channel=TimeStamped(2))
    for n in range(30):
        f.predict()
        f.update(float(n))
    assert f._state.mode


def test_a_filter_without_a_channel_loads_neither_channels_nor_scipy():
    script = (
        "import sys; from ufirext import UFIRFilter; f = UFIRFilter(2, 1); "
        "print({'scipy', 'ufirext.channels', 'ufirext.filters.kalman'} & set(sys.modules))"
    )
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "set()"


# -- duplicates --------------------------------------------------------------------------


@every_filter
def test_a_duplicate_is_dropped_and_a_repeat_with_fresh_noise_is_kept(make):
    duplicate, fresh = configured(make, channel=StampedLoss()), configured(make, channel=TimeStamped(1))
    for f in (duplicate, fresh):
        for n in range(12):
            f.predict()
            f.update(2.0 * n)
        f.predict()
        x = f.x.copy()
        f.update(20.0, delay=1)
        if f is duplicate:
            assert f.dropped == 1
            assert_allclose(f.x, x)
            f.predict()
            f.update(26.0, delay=0)
            assert f.dropped == 1
        else:
            assert f.dropped == 0
            assert np.abs(f.x - x).max() > 1e-3


@windowed
def test_a_lost_measurement_may_come_a_step_late(make):
    f = configured(make, channel=StampedLoss())
    for n in range(12):
        f.predict()
        f.update(None if n == 10 else 2.0 * n)
        if n == 11:
            f.update(20.0, delay=1)
    assert f.dropped == 0
    assert_allclose(f.x.ravel(), [22.0, 2.0], atol=1e-6)


# -- refusals ----------------------------------------------------------------------------


@windowed
@pytest.mark.parametrize("max_delay", [0, 2])
def test_a_channel_and_a_max_delay_together_are_refused(make, max_delay):
    with pytest.raises(UfirextError, match="max_delay is short for channel=TimeStamped"):
        make(max_delay=max_delay, channel=TimeStamped(2))


@every_filter
@pytest.mark.parametrize("channel", [3, "TimeStamped", TimeStamped])
def test_what_is_no_channel_is_refused(make, channel):
    with pytest.raises(UfirextError, match="channel must be a Channel such as"):
        make(channel=channel)


@every_filter
@pytest.mark.parametrize("max_delay", [-1, 1.5, True])
def test_a_bad_max_delay_is_refused(make, max_delay):
    with pytest.raises(HorizonError, match="max_delay must be"):
        make(max_delay=max_delay)


@every_filter
@every_channel
@pytest.mark.parametrize("delay", [-1, 3, 0.5, True, None, np.nan])
def test_a_delay_the_channel_cannot_produce_is_refused_and_nothing_changes(make, channel, delay):
    f = played(configured(make, channel=channel), channel, steps=12)
    f.predict()
    x, P = f.x.copy(), f.P.copy()
    with pytest.raises(HorizonError, match="delay must be"):
        f.update(1.0, delay=delay)
    assert np.array_equal(f.x, x)
    assert np.array_equal(f.P, P)


@every_filter
@every_channel
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"z": np.inf}, "z must be finite"),
        ({"z": [1.0, 2.0]}, "z must hold 1 number"),
        ({"z": "near"}, "z must be an array of real numbers"),
        ({"z": 1.0, "R": -1.0}, "R must be positive semidefinite"),
        ({"z": 1.0, "R": np.nan}, "R must be finite"),
        ({"z": 1.0, "R": np.eye(2)}, "R must have shape"),
        ({"z": 1.0, "H": [[1.0, np.inf]]}, "H must be finite"),
        ({"z": 1.0, "H": [1.0, 0.0, 0.0]}, "H must have shape"),
    ],
)
def test_bad_measurements_are_refused_and_nothing_changes(make, channel, arguments, message):
    f = played(configured(make, channel=channel), channel, steps=12)
    f.predict()
    x, P = f.x.copy(), f.P.copy()
    with pytest.raises(UfirextError, match=message):
        f.update(**arguments)
    assert np.array_equal(f.x, x)
    assert np.array_equal(f.P, P)


@every_filter
@every_channel
@pytest.mark.parametrize("z", [None, np.nan, [[np.nan]]])
def test_a_missing_measurement_leaves_the_prior(make, channel, z):
    f = played(configured(make, channel=channel), channel, steps=12)
    f.predict()
    x, P = f.x.copy(), f.P.copy()
    f.update(z)
    assert_allclose(f.x, x)
    if make is not hinfinity:
        assert_allclose(f.P, P)
    assert_allclose(f.y, 0.0)
    assert f.dropped == played(configured(make, channel=channel), channel, steps=12).dropped


@pytest.mark.parametrize("make", [ufir, adaptive, kalman])
def test_a_singular_transition_behind_an_averaging_channel_names_the_way_without_inverses(make):
    f = configured(make, channel=BernoulliDelay(0.7))
    f.F = np.array([[1.0, 1.0], [0.0, 0.0]])
    f.predict()
    x = f.x.copy()
    with pytest.raises(UfirextError, match=r"F must be invertible .* augmented"):
        f.update(1.0)
    assert_allclose(f.x, x)


@pytest.mark.parametrize("make", [ufir, fms])
def test_a_gain_that_changes_with_every_row_is_not_certified(make):
    with pytest.raises(UfirextError, match="must be the same at every step, behind BernoulliDelay"):
        configured(make, channel=BernoulliDelay(0.7)).certify()


@windowed
@every_channel
def test_the_first_update_may_come_before_the_first_predict(make, channel):
    f = configured(make, channel=channel)
    f.update(0.0)
    for n in range(1, 20):
        f.predict()
        f.update(2.0 * n - 2.0 * (1.0 - getattr(channel, "gamma", 1.0)))
    assert_allclose(f.x.ravel(), [38.0, 2.0], atol=1e-6)


# -- what is published -------------------------------------------------------------------


@pytest.mark.parametrize("make", [ufir, fms, kalman])
def test_k_is_the_gain_of_the_row_that_came_last(make):
    """Several rows of one step, the oldest last, of different sizes: K tells what the last one moved."""
    f = configured(make, max_delay=3)
    for n in range(4):
        f.predict()
        f.update(2.0 * n)
    f.predict()
    f.update(8.0)
    twin = copy.deepcopy(f)
    z, H = np.array([4.0, 2.0]), np.eye(2)
    f.update(z, R=np.eye(2), H=H, delay=2)
    for component in range(2):
        other = copy.deepcopy(twin)
        other.update(z + np.eye(2)[component], R=np.eye(2), H=H, delay=2)
        assert_allclose((other.x - f.x).ravel(), f.K[:, component], atol=1e-9)


@every_filter
@every_channel
@pytest.mark.parametrize("first", [None, 1.0])
def test_steady_state_keeps_k_and_s_whatever_was_missing(make, channel, first):
    f = played(configured(make, channel=channel), channel, steps=12)
    f.predict()
    f.update(first)
    f.predict_steadystate()
    K, S, P = f.K.copy(), f.S.copy(), f.P.copy()
    f.update_steadystate(60.0)
    assert_allclose(f.K, K)
    assert_allclose(f.S, S)
    assert_allclose(f.P, P)
    assert np.isfinite(f.log_likelihood)
