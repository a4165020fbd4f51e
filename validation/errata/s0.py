"""Errata of Uribe-Murcia, Shmaliy and Andrade-Lucio (2018)."""

from __future__ import annotations

import numpy as np

from ufirext import DelayHInfinityFilter, TimeStamped, UFIRFilter
from validation.claims import AtLeast, AtMost, absolute, relative, sampling
from validation.errata.erratum import Erratum, Numbers, errata_item
from validation.errata.literal import Array, paths, power, settled_ours, settled_peer, variance
from validation.item import Item
from validation.papers import S0
from validation.study import Study
from validation.vehicle import vehicle

__all__ = ["ITEM", "delayed_rows", "late_window"]

MODEL = vehicle()
F, H, Q, R = MODEL.F, MODEL.H, MODEL.Q, MODEL.R
N, DELAY = 8, 3
START, STEPS = 100.0, 20
SPEED = 10.0


def _prior(study: Study) -> Numbers:
    """(13) literally: no measurement ever enters."""
    P = START * np.eye(4)
    for _ in range(STEPS):
        P = F @ P @ F.T + Q
    ours, peer = settled_ours(MODEL, START, STEPS), settled_peer(MODEL, START, STEPS)
    return Numbers(float(P[0, 0]), float(ours.P_prior[0, 0]), float(peer.P_prior[0, 0]), unit="m²")


def _information(study: Study) -> Numbers:
    """(14) literally, as the covariance that section 2 calls it."""
    ours, peer = settled_ours(MODEL, START, STEPS), settled_peer(MODEL, START, STEPS)
    P = np.linalg.inv(peer.P_prior) + H.T @ np.linalg.inv(R) @ H
    return Numbers(float(P[0, 0]), float(ours.P[0, 0]), float(peer.P[0, 0]), unit="m²")


def _guarantee(form: str, theta: float) -> float:
    f = DelayHInfinityFilter(4, 2, theta=theta, form=form)
    f.F, f.H, f.Q, f.R, f.P = F, H, Q, R, 10.0 * np.eye(4)
    return float(f.worst_case_gain(40).gain)


def _mixed(study: Study) -> Numbers:
    """The printed gain where the printed condition allows it: the promise is J theta < 1."""
    return Numbers(AtMost(1.0, "J < 1/θ"), _guarantee("mixed", 0.05), AtLeast(1e6, "unbounded"))


def _posterior(study: Study) -> Numbers:
    """The gain that belongs to the printed condition keeps the promise that the printed one breaks."""
    return Numbers(
        _guarantee("mixed", 0.05), _guarantee("posterior", 0.05), AtMost(1.0, "J < 1/θ"), absolute(1e-9)
    )


def _own_delay(study: Study) -> Numbers:
    """Noise of a row that is one step late in a window whose newest row is three steps late."""
    newest = sum((H @ power(F, -i) @ Q @ power(F, -i).T @ H.T for i in range(1, DELAY + 1)), R)
    ours = TimeStamped(DELAY).effective(MODEL, 1).R
    x, _ = paths(study.rng("one late"), MODEL, 5, study.choose(40_000, 400_000))
    late = (x[:, 4] @ H.T - x[:, 5] @ power(F, -1).T @ H.T)[:, 0]
    mean, error = variance(late)
    return Numbers(
        float(newest[0, 0]), float(ours[0, 0]), float(R[0, 0]) + mean, sampling(4), error, unit="m²"
    )


def _straight(steps: int) -> Array:
    """Noise-free measurements of a car that drives east at 10 m/s."""
    return np.column_stack([SPEED * np.arange(steps), np.zeros(steps)])


def _reference(study: Study) -> Numbers:
    """(39) with the matrix of (30) estimates x_m; the car has driven on since."""
    zs = _straight(N)
    C = np.vstack([H @ power(F, i) for i in range(N)])
    x_m = np.linalg.solve(C.T @ C, C.T @ zs.reshape(-1))
    f = UFIRFilter(4, 2, horizon=N)
    f.F, f.H, f.R = F, H, R
    for z in zs:
        f.predict()
        f.update(z)
    return Numbers(round(float(x_m[0]), 9), float(f.x[0].item()), SPEED * (N - 1), absolute(1e-8), unit="m")


def _start(study: Study) -> Numbers:
    """Rows until the state is determined: K = 4 in (44)."""
    f = UFIRFilter(4, 2, horizon=N)
    f.F, f.H, f.R = F, H, R
    rows = 0
    for z in _straight(N):
        f.predict()
        f.update(z)
        rows += 1
        if f.ready:
            break
    ranks = [np.linalg.matrix_rank(np.vstack([H @ power(F, i) for i in range(n)])) for n in range(1, N)]
    return Numbers(4, rows, ranks.index(4) + 1, absolute(0.0))


def delayed_rows(k: int, steps: int) -> Array:
    """C_{m,n} of (38): every row k steps late, all referred to x_n."""
    return np.vstack([H @ power(F, -(steps - 1 - i) - k) for i in range(steps)])


def late_window(rng: np.random.Generator, count: int) -> Array:
    """Errors (count, 4) of the batch estimate (39) at constant delay, simulated."""
    steps = N + DELAY
    x, _ = paths(rng, MODEL, steps, count)
    z = x @ H.T + rng.multivariate_normal(np.zeros(2), R, (count, steps + 1))
    C = delayed_rows(DELAY, N)
    stacked = z[:, steps - DELAY - N + 1 : steps - DELAY + 1].reshape(count, -1)
    estimate = stacked @ np.linalg.lstsq(C, np.eye(len(C)), rcond=None)[0].T
    return np.asarray(estimate - x[:, -1])


def _late_covariance(study: Study, printed: float) -> Numbers:
    f = UFIRFilter(4, 2, horizon=N)
    f.F, f.H, f.Q, f.R = F, H, Q, R
    for _ in range(3 * N):
        f.predict()
        f.update(np.zeros(2), delay=DELAY)
    errors = late_window(study.rng("late window"), study.choose(40_000, 400_000))
    mean, error = variance(errors[:, 0])
    return Numbers(printed, float(f.P[0, 0]), mean, sampling(4), error, unit="m²")


def _batch_covariance(study: Study) -> Numbers:
    """(46) literally."""
    B = np.block([[power(F, i - j) if i >= j else np.zeros((4, 4)) for j in range(N)] for i in range(N)])
    C = delayed_rows(DELAY, N)
    G = np.kron(np.eye(N), H @ power(F, -DELAY)) @ B
    gain = np.linalg.solve(C.T @ C, C.T)
    error = B[-4:] - gain @ G
    P = error @ np.kron(np.eye(N), Q) @ error.T + gain @ np.kron(np.eye(N), R) @ gain.T
    return _late_covariance(study, float(P[0, 0]))


def _iterative_covariance(study: Study) -> Numbers:
    """(47) literally, with the prior of (17), from the noise of the first two rows on."""
    Hb = H @ power(F, -DELAY)
    grown = sum((power(F, i) @ Q @ power(F, i).T for i in range(DELAY)), np.zeros((4, 4)))
    C = delayed_rows(DELAY, 2)
    G = np.linalg.inv(C.T @ C)
    gain = G @ C.T
    P = gain @ np.kron(np.eye(2), R + Hb @ grown @ Hb.T) @ gain.T
    for _ in range(N - 2):
        G = np.linalg.inv(Hb.T @ Hb + np.linalg.inv(F @ G @ F.T))
        K = G @ Hb.T
        kept = np.eye(4) - K @ Hb
        P = kept @ (F @ P @ F.T + Q) @ kept.T + K @ (Hb @ grown @ Hb.T + R) @ K.T
    return _late_covariance(study, float(P[0, 0]))


def lossy_drive(rng: np.random.Generator, steps: int) -> tuple[float, float, float]:
    """Mean square errors where 10 % is lost: predicted as printed, left out; and what our filter believes."""
    x, _ = paths(rng, MODEL, steps, 1)
    z = x[0] @ H.T + rng.multivariate_normal(np.zeros(2), R, steps + 1)
    lost = rng.random(steps + 1) < 0.1
    printed, ours = (UFIRFilter(4, 2, horizon=6) for _ in range(2))
    squares, beliefs = [], []
    for f in (printed, ours):
        f.F, f.H, f.Q, f.R = F, H, Q, R
    for n in range(DELAY, steps + 1):
        for f in (printed, ours):
            f.predict()
        datum = z[n - DELAY]
        gone = lost[n] and n > DELAY + 10
        printed.update(H @ np.ravel(printed.x_prior) if gone else datum, delay=DELAY)
        ours.update(None if gone else datum, delay=0 if gone else DELAY)
        if n > DELAY + 30:
            squares.append([float((np.ravel(f.x)[0] - x[0, n, 0]) ** 2) for f in (printed, ours)])
            if n % 5 == 0:
                beliefs.append(float(ours.P[0, 0]))
    mean = np.mean(squares, axis=0)
    return float(mean[0]), float(mean[1]), float(np.mean(beliefs))


def _lost(study: Study) -> Numbers:
    found = np.sqrt(np.array(study.runs(lossy_drive, study.choose(24, 400), 150)))
    printed, ours, own = np.sqrt((found**2).mean(axis=0))
    spread = float((found[:, 1] ** 2).std(ddof=1) / np.sqrt(len(found)) / (2 * ours))
    return Numbers(float(printed), float(ours), float(own), sampling(4) + relative(0.01), spread, unit="m")


def _range(first: int, last: int, printed: int) -> Numbers:
    return Numbers(printed, len(range(first, last + 1)), sum(first <= n <= last for n in range(858)))


ITEM: Item = errata_item(
    S0,
    [
        Erratum(
            "(13)",
            "prior position variance after 20 measurements",
            "P⁻_n = F P⁻_{n-1} F' + Q, which no measurement ever enters",
            "F P_{n-1}^{-1} F' + Q, as (17) has it: the paper's P is an information matrix",
            _prior,
        ),
        Erratum(
            "(14) to (21)",
            "posterior position variance",
            "P_n, the error covariance",
            "P_n is the information matrix, the inverse of the covariance",
            _information,
        ),
        Erratum(
            "(18) to (22)",
            "J θ of the printed gain, θ = 0.05",
            "gain (19) of the a-priori filter with condition (22) of the a-posteriori filter",
            "between the two limits this pairing is unstable: that is what diverges in the paper",
            _mixed,
        ),
        Erratum(
            "(19)",
            "J θ of the gain that belongs to (22), θ = 0.05",
            "gain (P⁻^{-1} - θ S + H'R^{-1}H)^{-1} H'R^{-1}",
            "(P⁻^{-1} + H'R^{-1}H)^{-1} H'R^{-1}, the ordinary gain",
            _posterior,
        ),
        Erratum(
            "(27), (30) to (32)",
            "noise variance of a row one step late, newest row three steps late",
            "B̄_n of the newest row in every row",
            "each row has its own delay",
            _own_delay,
        ),
        Erratum(
            "(30) with (39)",
            "position of a car without noise",
            "C_{m,n} of (30), which refers to x_m, in (39)",
            "C_{m,n} of (38), which refers to x_n; with (30) prepend F^{N-1}",
            _reference,
        ),
        Erratum(
            "section 3.2",
            "RMSE with 10 % lost at delay 3",
            "y = H F x̂ for a lost datum, which is then taken as three steps late",
            "H̄ F x̂; better, leave the row out, as done here",
            _lost,
        ),
        Erratum(
            "(44)",
            "rows until four states are determined",
            "s = m + K - 1: K rows, always",
            "the first prefix of rows that determines the state",
            _start,
        ),
        Erratum(
            "(46)",
            "position variance at delay 3, N = 8",
            "B - H G, whose rows H F^{-k} B hold noise that had not happened yet",
            "the exact covariance of late rows; (46) holds at delay 0",
            _batch_covariance,
        ),
        Erratum(
            "(47)",
            "position variance at delay 3, N = 8",
            "a recursion that takes the noise of late rows for white",
            "the exact covariance of late rows; (47) holds at delay 0",
            _iterative_covariance,
        ),
        Erratum(
            "section 5.4",
            "data lost at 615 to 620",
            "5 points",
            "the range holds 6",
            lambda study: _range(615, 620, 5),
        ),
        Erratum(
            "section 5.4",
            "data lost at 665 to 675",
            "10 points",
            "the range holds 11",
            lambda study: _range(665, 675, 10),
        ),
    ],
    "section 5.2 says Fig. 2 where it means Fig. 3.",
)
