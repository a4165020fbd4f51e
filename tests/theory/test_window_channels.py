"""Window filters behind channels: the rows they hold are those of the channel, and P is what it says."""

from __future__ import annotations

import copy
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tests.naive_filter import NaiveUFIR
from tests.oracles import block_diagonal, determined, naive_gain, phi
from tests.strategies import random_model, seeds
from tests.theory.delays import F1, H1, Q1, R1
from ufirext import FMSFilterSmoother, Model, UFIRFilter
from ufirext.channels import BernoulliDelay, CompensatedBernoulli, StampedLoss, Step, TimeStamped

few = settings(max_examples=25)
INVERTIBLE = st.sampled_from(("marginal", "oscillating", "unstable"))
UNSTAMPED = st.sampled_from([BernoulliDelay(0.7), BernoulliDelay(0.2), CompensatedBernoulli(0.5, 0.8)])
HORIZON = 6


class Weighed(NamedTuple):
    """An effective row: z + offset = H x_n + e - G w_n, cov e = own."""

    step: int
    z: np.ndarray
    H: np.ndarray
    own: np.ndarray
    G: np.ndarray


class Effective:
    """All rows of a run and its transitions; the regression of the newest ones, naive and from scratch.

    The noises are [w_old; w_{old+1}; ..; w_now]: what entered with the oldest state is in its row as well.
    """

    def __init__(self, dim_x: int) -> None:
        self.n, self.F, self.Q, self.known, self.rows = dim_x, {}, {}, {}, []

    def stacked(self, now: int, horizon: int = HORIZON) -> Any:
        rows = [row for row in self.rows if row.step > now - horizon]
        old, n = rows[0].step, self.n
        blocks = range(old, now + 1)

        def into(time: int) -> np.ndarray:
            return np.hstack([phi(self.F, time, j) if old < j <= time else np.zeros((n, n)) for j in blocks])

        known = {old: np.zeros(n)}
        for j in range(old + 1, now + 1):
            known[j] = self.F[j] @ known[j - 1] + self.known[j]
        D = [row.H @ into(row.step) for row in rows]
        for part, row in zip(D, rows, strict=True):
            part[:, (row.step - old) * n : (row.step - old + 1) * n] -= row.G
        window = Stack(
            C=np.vstack([row.H @ phi(self.F, row.step, old) for row in rows]),
            D=np.vstack(D),
            V=block_diagonal([row.own for row in rows]),
            W=block_diagonal([row.own + row.G @ self.Q[row.step] @ row.G.T for row in rows]),
            T=phi(self.F, now, old),
            E=into(now),
            Q=block_diagonal([self.Q[j] for j in blocks]),
            Z=np.concatenate([row.z - row.H @ known[row.step] for row in rows]),
            known=known[now],
        )
        return window if determined(window.C, window.T) else None


class Stack(NamedTuple):
    """Z = C x_old + D w + e, x_now = T x_old + E w; V is cov e, W that of each row's whole noise."""

    C: np.ndarray
    D: np.ndarray
    V: np.ndarray
    W: np.ndarray
    T: np.ndarray
    E: np.ndarray
    Q: np.ndarray
    Z: np.ndarray
    known: np.ndarray

    def covariance(self, K: np.ndarray) -> np.ndarray:
        left = self.E - K @ self.D
        return left @ self.Q @ left.T + K @ self.V @ K.T

    def least_squares(self) -> np.ndarray:
        return naive_gain(self._replace(V=self.W))

    def best(self) -> np.ndarray:
        S, M = self.D @ self.Q @ self.D.T + self.V, self.E @ self.Q @ self.D.T
        J = np.linalg.solve(S, M.T).T
        white = np.linalg.solve(S, self.C)
        return J + (self.T - J @ self.C) @ np.linalg.solve(self.C.T @ white, white.T)


def filters_of(model: Model, channel: Any, horizon: int = HORIZON) -> dict[str, Any]:
    made: dict[str, Any] = {
        "ufir": UFIRFilter(model.dim_x, model.dim_z, horizon=horizon, channel=channel),
        "fms": FMSFilterSmoother(model.dim_x, model.dim_z, horizon=horizon, lag=1, channel=channel),
    }
    for f in made.values():
        f.F, f.H, f.Q, f.R, f.B = model.F, model.H, model.Q, model.R, np.eye(model.dim_x)
        f.P = 10.0 * np.eye(model.dim_x)
    return made


# -- without stamps ----------------------------------------------------------------------


@few
@given(
    seeds,
    INVERTIBLE,
    st.sampled_from([BernoulliDelay(0.7), BernoulliDelay(0.2), CompensatedBernoulli(0.5, 0.8)]),
)
def test_an_averaged_row_is_the_channels_effective_row(seed, kind, channel):
    """Naive least squares and minimum variance of the effective rows, inputs, changing F, losses included."""
    rng = np.random.default_rng(seed)
    model = random_model(seed, 3, 2, kind)
    for name, f in filters_of(model, channel).items():
        naive, compared = Effective(3), 0
        for step in range(1, 16):
            F = model.F + (0.05 * rng.normal(size=(3, 3)) if rng.random() < 0.3 else 0.0)
            u = rng.normal(size=3) if rng.random() < 0.3 else np.zeros(3)
            naive.F[step], naive.Q[step], naive.known[step] = F, model.Q, u
            f.predict(u, F=F)
            z = 3.0 * rng.normal(size=2)
            if rng.random() < 0.2:
                f.update(None)
                continue
            row = channel.effective(model, past=[Step(F, model.Q, u)], x=f.x_prior, P=f.P_prior)
            own = row.R - row.G[0] @ model.Q @ row.G[0].T
            naive.rows.append(Weighed(step, z + row.offset, row.H, own, row.G[0]))
            f.update(z)
            recent = [row for row in naive.rows if row.step > step - HORIZON]
            window = naive.stacked(step)
            if window is None or len(recent) < 5:  # fewer: the window reaches further back
                continue
            K = window.least_squares() if name == "ufir" else window.best()
            x, P = window.known + K @ window.Z, window.covariance(K)
            assert_allclose(f.x.ravel(), x, atol=1e-6 * max(1.0, np.abs(x).max()), err_msg=name)
            assert_allclose(f.P, P, atol=1e-6 * np.abs(P).max(), err_msg=name)
            compared += 1
        assume(compared)


@pytest.mark.parametrize("name", ["ufir", "fms"])
def test_y_s_and_k_belong_to_the_averaged_row(name):
    channel, model = BernoulliDelay(0.6), Model(F1, H1, Q1, R1)
    f = filters_of(model, channel)[name]
    for step in range(4):
        f.predict([1.0, 0.5])
        x, P = f.x_prior.copy(), f.P_prior.copy()
        z = np.array([7.0 * step + 3.0])
        twin = copy.deepcopy(f)
        row = channel.effective(model, past=[Step(F1, Q1, np.array([1.0, 0.5]))], x=x, P=P)
        f.update(z)
        assert_allclose(f.z, [z])
        assert_allclose(f.y, z + row.offset - row.H @ x.ravel()[:, None], atol=1e-9)
        S = row.H @ P @ row.H.T + row.R + row.H @ row.correlation + row.correlation.T @ row.H.T
        assert_allclose(f.S, S, rtol=1e-9)
        if step >= 1:  # the window grows: the newest row's gain tells what it moves
            twin.update(z + 1.0)
            assert_allclose(twin.x - f.x, f.K, atol=1e-6)


@pytest.mark.parametrize("channel", [BernoulliDelay(0.7), CompensatedBernoulli(0.6, 0.5)])
def test_rows_without_noise_give_the_exact_state_also_for_a_singular_f(channel):
    """What averages to H x over the delay is taken without bias; only UFIR's row needs an inverse of F."""
    singular = np.array([[1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    for F, names in ((np.eye(3) + np.diag([1.0, 1.0], 1), ("ufir", "fms")), (singular, ("fms",))):
        model = Model(F, [[1.0, 0.0, 0.5]], Q=0.01 * np.eye(3), R=1.0)
        for name in names:
            f = filters_of(model, channel, horizon=8)[name]
            x, gamma, moved = np.array([5.0, -1.0, 0.5]), channel.gamma, 0.0
            for step in range(20):
                u = np.array([0.3, -0.2, 0.1]) * step
                before, x = x - moved, F @ x + u
                f.predict(u)
                f.update(model.H @ (gamma * x + (1 - gamma) * before))
                # An edit moves the state by a known amount, after all that was measured in its step.
                moved = 2.0 if step % 5 == 3 else 0.0
                if moved:
                    f.x, x = f.x + moved, x + moved
            assert_allclose(f.x.ravel(), x, atol=1e-7 * np.abs(x).max(), err_msg=name)


def test_a_delay_that_never_happens_leaves_the_filters_as_they_are():
    model = Model(F1, H1, Q1, R1)
    for name, f in filters_of(model, BernoulliDelay(1.0)).items():
        plain = filters_of(model, None)[name]
        for z in np.random.default_rng(0).normal(size=25).cumsum():
            for each in (f, plain):
                each.predict()
                each.update(z)
            assert_allclose(f.x, plain.x, atol=1e-9)
            assert_allclose(f.P, plain.P, rtol=1e-9)


@pytest.mark.parametrize("name", ["ufir", "fms"])
def test_two_sensors_of_one_step_share_its_process_noise(name):
    """Their effective noises are correlated with each other: the window's P knows."""
    channel, model = BernoulliDelay(0.6), Model(F1, H1, Q1, R1)
    f, naive = filters_of(model, channel)[name], Effective(2)
    rng = np.random.default_rng(5)
    for step in range(1, 12):
        naive.F[step], naive.Q[step], naive.known[step] = F1, Q1, np.zeros(2)
        f.predict()
        f.x = [0.0, 0.0] if step == 1 else f.x
        for H in (H1, np.array([[1.0, 0.3]])):
            z = rng.normal(size=1)
            # The spread of the second one is taken from what its filter knows then.
            f.update(z, R=R1, H=H)
            used = f._state.last
            present = used.H[:, :2] + (used.H[:, 2:] @ np.linalg.inv(F1) if used.H.shape[1] == 4 else 0.0)
            G = 0.4 * H @ np.linalg.inv(F1)
            own = used.R - (G @ Q1 @ G.T if used.H.shape[1] == 2 else 0.0)
            naive.rows.append(Weighed(step, z, present, own, G))
    window = naive.stacked(11)
    K = window.least_squares() if name == "ufir" else window.best()
    assert_allclose(f.x.ravel(), K @ window.Z, atol=1e-8)
    assert_allclose(f.P, window.covariance(K), rtol=1e-7)


# -- Monte Carlo -------------------------------------------------------------------------


def errors_of(channel: Any, runs: int, steps: int = 18) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Errors (runs, 2) and believed covariances (runs, 2, 2) after the last step, of each filter."""
    rng = np.random.default_rng(3)
    model = Model(F1, H1, 0.05 * Q1, R1)
    found: dict[str, tuple[list[Any], list[Any]]] = {"ufir": ([], []), "fms": ([], [])}
    for _ in range(runs):
        x, truth = np.array([0.0, 10.0]), []
        for _ in range(steps):
            x = F1 @ x + rng.multivariate_normal(np.zeros(2), model.Q)
            truth.append(x)
        arrivals = channel.sample(rng, [state[:1] for state in truth], R=R1)
        for name, f in filters_of(model, channel, horizon=8).items():
            f.x = [0.0, 10.0]
            for packets in arrivals:
                f.predict()
                for packet in packets:
                    f.update(packet.z, delay=packet.delay)
            found[name][0].append(f.x.ravel() - x)
            found[name][1].append(f.P)
    return {name: (np.array(errors), np.array(Ps)) for name, (errors, Ps) in found.items()}


@pytest.mark.parametrize(
    "channel",
    [TimeStamped(3, law=(0.4, 0.3, 0.2, 0.1), loss=0.1), StampedLoss(0.6, 0.9), BernoulliDelay(0.7)],
    ids=["time-stamped", "stamped loss", "unknown delay"],
)
def test_no_bias_and_the_believed_covariance_is_the_true_one(channel):
    runs = 150
    for name, (errors, believed) in errors_of(channel, runs).items():
        assert (np.abs(errors.mean(axis=0)) < 4.5 * errors.std(axis=0) / np.sqrt(runs)).all(), name
        gaps = errors**2 - np.diagonal(believed, axis1=1, axis2=2)
        assert (np.abs(gaps.mean(axis=0)) < 4.5 * gaps.std(axis=0) / np.sqrt(runs)).all(), name


# -- with stamps -------------------------------------------------------------------------


@few
@given(seeds, st.sampled_from(["arrivals", "origins"]), st.booleans())
def test_stamped_rows_are_the_naive_filters_older_rows_without_duplicates(seed, window, repeats):
    rng = np.random.default_rng(seed)
    channel = TimeStamped(1) if repeats else StampedLoss(0.5, 0.8)
    f = UFIRFilter(2, 1, horizon=5, window=window, channel=channel)
    f.F, f.H, f.Q, f.R = F1, H1, Q1, R1
    naive = NaiveUFIR(F1, H1, Q1, R1, np.zeros(2), np.eye(2), 5, window=window)
    seen: set[int] = set()
    arrivals = StampedLoss(0.5, 0.8).sample(rng, rng.normal(size=30).cumsum(), R=R1)
    for step, packets in enumerate(arrivals, start=1):
        f.predict()
        naive.predict()
        for packet in packets:
            f.update(packet.z, delay=packet.delay)
            new = repeats or step - packet.delay not in seen
            naive.update(packet.z if new else None, delay=packet.delay)
            seen.add(step - packet.delay)
        if naive.ready:
            assert_allclose(f.x.ravel(), naive.x, atol=1e-8)
            assert_allclose(f.P, naive.P, atol=1e-8 * np.abs(naive.P).max())
    taken = sum(map(len, arrivals))
    assert f.dropped == (0 if repeats else taken - len(seen))


def test_minimum_variance_behind_a_stamped_channel_is_that_of_the_older_rows():
    plain, behind = (filters_of(Model(F1, H1, Q1, R1), channel)["fms"] for channel in (None, TimeStamped(3)))
    rng = np.random.default_rng(8)
    for step in range(30):
        for f in (plain, behind):
            f.predict()
        for delay in {int(rng.integers(0, 4)) for _ in range(2)}:
            if step >= delay:
                z = rng.normal()
                for f in (plain, behind):
                    f.update(z, delay=delay)
        assert_allclose(behind.x, plain.x, atol=1e-12)
        assert_allclose(behind.P, plain.P, atol=1e-12)
