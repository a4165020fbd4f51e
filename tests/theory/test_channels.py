"""Channels: what arrives is a measurement of the present state with a noise that is known exactly."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tests.strategies import positive, random_model, seeds
from tests.theory.delays import F1, H1, Q1, R1
from ufirext import Model
from ufirext.channels import BernoulliDelay, CompensatedBernoulli, StampedLoss, Step, TimeStamped
from ufirext.errors import HorizonError, UfirextError

INVERTIBLE = st.sampled_from(("unstable", "marginal", "oscillating"))
delays = st.integers(0, 5)


def one_axis(speed_noise: float = 1.0) -> Model:
    return Model(F1, H1, Q=speed_noise * Q1, R=R1)


@given(seeds, INVERTIBLE, delays)
def test_a_stamped_measurement_is_one_of_the_present_state_realisation_by_realisation(seed, kind, delay):
    rng = np.random.default_rng(seed)
    model = random_model(seed, 3, 2, kind)
    past = [
        Step(random_model(seed + i, 3, 2, kind).F, positive(rng, 3), rng.normal(size=3)) for i in range(5)
    ]
    x = [rng.normal(size=3)]
    noises = []
    for F, _, Bu in past:
        noises.append(rng.normal(size=3))
        x.append(F @ x[-1] + Bu + noises[-1])
    row = TimeStamped(5).effective(model, delay, past=past)
    exact = model.H @ x[5 - delay]
    told = row.H @ x[5] - sum((G @ w for G, w in zip(row.G, noises[::-1], strict=False)), np.zeros(2))
    assert_allclose(exact + row.offset, told, rtol=1e-7, atol=1e-7 * np.abs(row.H).max())


@given(seeds, INVERTIBLE, delays)
def test_the_noise_of_a_stamped_measurement_has_the_papers_covariance(seed, kind, delay):
    model = random_model(seed, 3, 2, kind)
    back = np.linalg.matrix_power(np.linalg.inv(model.F), delay)
    powers = [np.linalg.matrix_power(model.F, i) for i in range(delay)]
    H = model.H @ back
    R = model.R + H @ sum((A @ model.Q @ A.T for A in powers), np.zeros((3, 3))) @ H.T
    row = TimeStamped(5).effective(model, delay)
    assert_allclose(row.H, H, rtol=1e-8, atol=1e-8 * np.abs(H).max())
    assert_allclose(row.R, R, rtol=1e-8, atol=1e-8 * np.abs(R).max())
    expected = -model.Q @ H.T if delay else np.zeros((3, 2))
    assert_allclose(row.correlation, expected, rtol=1e-8, atol=1e-8 * max(np.abs(expected).max(), 1.0))


def test_without_delay_a_measurement_is_itself():
    row = TimeStamped(3).effective(one_axis(), 0)
    assert row.H.tolist() == H1.tolist()
    assert row.R.tolist() == R1.tolist()
    assert not row.correlation.any()
    assert row.G == ()


@given(seeds, INVERTIBLE, st.floats(0.0, 1.0))
def test_an_unknown_delay_averages_to_the_moments_of_the_mixture(seed, kind, gamma):
    rng = np.random.default_rng(seed)
    model = random_model(seed, 3, 2, kind)
    Bu, mean, P = rng.normal(size=3), 3 * rng.normal(size=3), positive(rng, 3)
    # [x_{n-1}; w] has covariance blkdiag(P, Q); both outcomes of z are linear in it.
    cov = np.block([[P, np.zeros((3, 3))], [np.zeros((3, 3)), model.Q]])
    now, before = np.hstack([model.F, np.eye(3)]), np.hstack([np.eye(3), np.zeros((3, 3))])
    mean_now = model.F @ mean + Bu
    row = BernoulliDelay(gamma).effective(
        model, past=[Step(model.F, model.Q, Bu)], x=mean_now, P=now @ cov @ now.T
    )
    second, cross = model.R.copy(), np.zeros((3, 2))
    for probability, A, centre in ((gamma, now, mean_now), (1 - gamma, before, mean)):
        error = model.H @ A - row.H @ now
        shift = model.H @ centre + row.offset - row.H @ mean_now
        second = second + probability * (error @ cov @ error.T + np.outer(shift, shift))
        cross = cross + probability * (cov[3:] @ error.T)
    size = max(np.abs(second).max(), 1.0)
    assert_allclose(row.R, second, rtol=1e-7, atol=1e-8 * size)
    assert_allclose(row.correlation, cross, rtol=1e-7, atol=1e-8 * size)


@given(seeds, INVERTIBLE, st.floats(0.0, 1.0), st.floats(-3.0, 1.0))
def test_the_averaged_noise_is_a_covariance_whatever_p_says(seed, kind, gamma, size):
    """P may be written from outside, and then be smaller than the noise that entered."""
    rng = np.random.default_rng(seed)
    model = random_model(seed, 3, 2, kind)
    row = BernoulliDelay(gamma).effective(model, x=rng.normal(size=3), P=10.0**size * positive(rng, 3))
    assert np.linalg.eigvalsh(row.R - model.R)[0] > -1e-9 * np.abs(row.R).max()


def test_at_10_m_s_the_averaged_noise_is_twice_what_the_paper_prints():
    model = one_axis()
    row = BernoulliDelay(0.8).effective(model, x=[0.0, 10.0], P=model.Q)
    Hd = H1 @ np.linalg.inv(F1)
    printed = R1 + 0.2**2 * Hd @ Q1 @ Hd.T
    assert printed.item() == pytest.approx(14.1, abs=0.05)
    assert row.R.item() == pytest.approx(30.5, abs=0.05)


def test_the_averaged_noise_is_the_simulated_one():
    rng = np.random.default_rng(5)
    model, channel, runs = one_axis(), BernoulliDelay(0.6), 40_000
    before = np.array([3.0, 10.0])
    now = F1 @ before + rng.multivariate_normal(np.zeros(2), Q1, runs)
    prompt = rng.random(runs) < channel.gamma
    z = np.where(prompt, now[:, 0], before[0]) + rng.normal(0.0, 3.75, runs)
    row = channel.effective(model, x=F1 @ before, P=model.Q)
    residual = z - now @ row.H[0]
    squares = residual**2
    assert abs(squares.mean() - row.R.item()) < 5 * squares.std() / np.sqrt(runs)


def test_the_compensated_channel_is_the_binary_one_given_that_something_arrived():
    model, prior = one_axis(), {"x": [1.0, 5.0], "P": np.eye(2)}
    channel = CompensatedBernoulli(0.7, 0.9)
    assert channel.gamma == pytest.approx(0.7 / (0.7 + 0.3**2 * 0.9))
    one, other = channel.effective(model, **prior), BernoulliDelay(channel.gamma).effective(model, **prior)
    assert_allclose(one.R, other.R)
    assert_allclose(one.H, other.H)


def test_the_lifted_average_has_the_same_mean_and_spread_as_the_averaged_row():
    model, gamma = one_axis(), 0.7
    x, P = np.array([1.0, 10.0, -8.0, 9.0]), np.eye(4)
    H, R = BernoulliDelay(gamma).lifted(model.H, model.R, 0, x, P)
    assert_allclose(H, [[gamma, 0.0, 1 - gamma, 0.0]])
    assert R.item() == pytest.approx(3.75**2 + gamma * (1 - gamma) * (9.0**2 + 2.0))


# -- simulation --------------------------------------------------------------------------------


def test_a_stamped_channel_delivers_every_measurement_at_most_once_with_its_true_delay():
    zs = np.arange(2000.0)
    law = (0.5, 0.0, 0.2, 0.3)
    arrived = TimeStamped(3, law=law, loss=0.1).sample(np.random.default_rng(0), zs)
    packets = [(step, p) for step, packets in enumerate(arrived) for p in packets]
    assert all(step - p.delay == p.origin == p.z[0] for step, p in packets)
    assert len({p.origin for _, p in packets}) == len(packets)
    counts = np.bincount([p.delay for _, p in packets], minlength=4) / len(packets)
    assert_allclose(counts, law, atol=5 * 0.5 / np.sqrt(len(packets)))
    assert len(packets) / 2000 == pytest.approx(0.9, abs=5 * 0.3 / np.sqrt(2000))


def test_a_masked_measurement_is_sent_as_a_missing_one():
    zs = np.ma.array([[1.0, 2.0], [3.0, 4.0]], mask=[[False, True], [False, False]])
    (first,), (second,) = TimeStamped(0).sample(np.random.default_rng(0), zs)
    np.testing.assert_array_equal([first.z, second.z], zs.filled(np.nan))


def test_stamped_loss_repeats_measurements_with_the_same_noise():
    zs = np.random.default_rng(1).normal(size=400)
    arrived = StampedLoss(on_time=0.6, received=0.8).sample(np.random.default_rng(2), zs)
    packets = [(step, p) for step, packets in enumerate(arrived) for p in packets]
    assert all(p.z[0] == zs[p.origin] and step - p.delay == p.origin for step, p in packets)
    origins = [p.origin for _, p in packets]
    assert len(set(origins)) < len(origins)


def test_the_compensated_channel_never_repeats_and_hides_the_delay():
    channel = CompensatedBernoulli(0.7, 0.9)
    arrived = channel.sample(np.random.default_rng(3), np.arange(20_000.0))
    packets = [(step, p) for step, packets in enumerate(arrived) for p in packets]
    assert {p.delay for _, p in packets} == {0}
    origins = [p.origin for _, p in packets]
    assert len(set(origins)) == len(origins)
    prompt = np.mean([step == p.origin for step, p in packets])
    assert prompt == pytest.approx(channel.gamma, abs=5 * 0.5 / np.sqrt(len(packets)))
    assert len(packets) / 20_000 == pytest.approx(0.7 + 0.3**2 * 0.9, abs=5 * 0.5 / np.sqrt(20_000))


def test_fresh_noise_is_drawn_at_every_arrival_and_other_noise_once():
    def repeats(channel):
        arrived = channel.sample(np.random.default_rng(4), np.zeros((500, 2)), R=np.eye(2))
        seen: dict[int, list[float]] = {}
        for packet in (p for packets in arrived for p in packets):
            seen.setdefault(packet.origin, []).append(float(packet.z[0]))
        return [values for values in seen.values() if len(values) == 2]

    fresh, same = repeats(BernoulliDelay(0.5)), repeats(StampedLoss(0.5))
    assert fresh
    assert same
    assert all(a != b for a, b in fresh)
    assert all(a == b for a, b in same)


def test_the_same_generator_gives_the_same_packets():
    zs = np.zeros((50, 1))
    one, two = (TimeStamped(4).sample(np.random.default_rng(7), zs, R=1.0) for _ in range(2))
    assert [[(p.z.tolist(), p.delay) for p in s] for s in one] == [
        [(p.z.tolist(), p.delay) for p in s] for s in two
    ]


# -- refusals --------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [-0.1, 1.1, np.nan, [0.5, 0.5]])
@pytest.mark.parametrize(
    "build",
    [
        BernoulliDelay,
        lambda p: StampedLoss(on_time=p),
        lambda p: StampedLoss(received=p),
        lambda p: CompensatedBernoulli(p, 0.5),
        lambda p: CompensatedBernoulli(0.5, p),
        lambda p: TimeStamped(1, loss=p),
    ],
)
def test_what_is_no_probability_is_refused(build, value):
    with pytest.raises(UfirextError, match="must be a probability between 0 and 1"):
        build(value)


def test_a_law_must_cover_all_delays_and_sum_to_one():
    for law in ((0.5, 0.4), (1.0,), (0.2, 0.3, 0.5)):
        with pytest.raises(UfirextError, match="law must hold max_delay \\+ 1 = 2 probabilities"):
            TimeStamped(1, law=law)


def test_a_channel_that_delivers_nothing_is_refused():
    with pytest.raises(UfirextError, match="nothing could ever arrive"):
        CompensatedBernoulli(0.0, 0.0)


@pytest.mark.parametrize("delay", [-1, 4, 1.5, True])
def test_a_delay_outside_the_channels_range_is_refused(delay):
    with pytest.raises(HorizonError, match="delay must be"):
        TimeStamped(3).effective(one_axis(), delay)


@pytest.mark.parametrize("max_delay", [-1, 1.5, None])
def test_a_bad_max_delay_is_refused(max_delay):
    with pytest.raises(HorizonError, match="max_delay must be"):
        TimeStamped(max_delay)


def test_a_channel_without_stamps_takes_no_delay():
    with pytest.raises(HorizonError, match="no time stamps"):
        BernoulliDelay(0.5).effective(one_axis(), 1, x=[0, 0], P=np.eye(2))


@pytest.mark.parametrize("channel", [TimeStamped(1), BernoulliDelay(0.5)])
def test_a_singular_transition_names_the_augmented_way(channel):
    model = Model([[1.0, 1.0], [0.0, 0.0]], H1, R=1.0)
    with pytest.raises(UfirextError, match="augmented"):
        channel.effective(model, int(channel.stamped), x=[0, 0], P=np.eye(2))


def test_an_unknown_delay_needs_the_filters_prior():
    with pytest.raises(UfirextError, match="x and P must be given"):
        BernoulliDelay(0.5).effective(one_axis())


def test_channels_are_values():
    assert TimeStamped(2) == TimeStamped(2) != TimeStamped(3)
    assert hash(BernoulliDelay(0.5)) == hash(BernoulliDelay(0.5))
    with pytest.raises(AttributeError):
        BernoulliDelay(0.5).gamma = 0.6
