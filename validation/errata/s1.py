"""Errata of Uribe-Murcia et al. (2022)."""

from __future__ import annotations

import numpy as np

from ufirext import CompensatedBernoulli, DelayKalmanFilter, Model, StampedLoss, TimeStamped, UFIRFilter
from validation.claims import absolute, sampling
from validation.errata import windows
from validation.errata.erratum import Erratum, Numbers, errata_item
from validation.errata.literal import paths, power, variance
from validation.item import Item
from validation.papers import S1
from validation.study import Study
from validation.vehicle import vehicle

__all__ = ["ITEM"]

MODEL = vehicle()
"""With the Q of 2018: in the singular Q of this paper, 0.02 m², errors of Q would drown in R."""
RESTLESS = vehicle(sigma_w=8.0)
F, H, Q, R = MODEL.F, MODEL.H, MODEL.Q, MODEL.R
A0, A1 = 0.7, 0.9
BACK = 3


def _columns(study: Study) -> Numbers:
    return Numbers(MODEL.dim_z, MODEL.H.shape[1], MODEL.dim_x, absolute(0.0))


def _rebuilt(study: Study) -> Numbers:
    """The position three steps ago from the present state and the noises since."""
    x, w = paths(study.rng("rebuilt"), MODEL, BACK + 2, 2000)
    true = x[:, 2] @ H.T
    printed = (x[:, -1] - w[:, -BACK:].sum(axis=1)) @ power(F, -BACK).T @ H.T
    effective = TimeStamped(BACK).effective(MODEL, BACK)
    ours = x[:, -1] @ effective.H.T
    for i, G in enumerate(effective.G):
        ours = ours - w[:, -1 - i] @ G.T
    rms = [float(np.sqrt(((value - true)[:, 0] ** 2).mean())) for value in (printed, ours)]
    return Numbers(rms[0], rms[1], 0.0, absolute(1e-10), unit="m")


def _noise_term(study: Study) -> Numbers:
    """The measurement before this one, without its own noise, from x_n and w_n."""
    x, w = paths(study.rng("term"), MODEL, 3, 2000)
    true = x[:, -2] @ H.T
    effective = StampedLoss().effective(MODEL, 1)
    now = x[:, -1] @ effective.H.T
    printed, ours = now - w[:, -1] @ H.T, now - w[:, -1] @ effective.G[0].T
    rms = [float(np.sqrt(((value - true)[:, 0] ** 2).mean())) for value in (printed, ours)]
    return Numbers(rms[0], rms[1], 0.0, absolute(1e-10), unit="m")


def _late_noise(study: Study, model: Model, printed: float, stream: str) -> Numbers:
    """Variance of the noise of a measurement that is one step late."""
    ours = StampedLoss().effective(model, 1).R
    x, _ = paths(study.rng(stream), model, 3, study.choose(40_000, 400_000))
    late = (x[:, -2] @ H.T - x[:, -1] @ power(model.F, -1).T @ H.T)[:, 0]
    mean, error = variance(late)
    truth = float(model.R[0, 0]) + mean
    return Numbers(printed, float(ours[0, 0]), truth, sampling(4), error, unit="m²")


def _indefinite(study: Study) -> Numbers:
    printed = RESTLESS.R - H @ RESTLESS.Q @ H.T
    return _late_noise(study, RESTLESS, float(printed[0, 0]), "restless")


def _delay_branch(study: Study) -> Numbers:
    """(12) where a0 = a0' = 0, a1 = 1: its term in Q has the factor (1 - a0)(1 - (1 - a0') a1) = 0."""
    return _late_noise(study, MODEL, float(R[0, 0]), "branch")


def _repeat(study: Study) -> Numbers:
    """Mean square difference of a late measurement to what the sensor measured then."""
    rng = study.rng("repeat")
    zs = rng.standard_normal((2000, 2)) * np.sqrt(R[0, 0])
    arrivals = StampedLoss(on_time=A0, received=1.0).sample(rng, zs)
    late = [p.z - zs[p.origin] for packets in arrivals for p in packets if p.delay]
    return Numbers(2.0 * float(R[0, 0]), float(np.mean(np.square(late))), 0.0, absolute(0.0), unit="m²")


def _scalar_term(study: Study) -> Numbers:
    """How the east measurement depends on the position north: (10) adds a scalar to every entry."""
    printed = (1 - A0) * (1 - (1 - A0) * A1)
    ours = CompensatedBernoulli(A0, A1).effective(MODEL, x=np.zeros(4), P=Q).H
    return Numbers(printed, float(ours[0, 2]), 0.0, absolute(0.0))


def _correlation(study: Study) -> Numbers:
    """E[w_n v̄_n'] of the position, where what arrives is one step late."""
    effective = StampedLoss().effective(MODEL, 1)
    x, w = paths(study.rng("phi"), MODEL, 3, study.choose(40_000, 400_000))
    noise = (x[:, -2] @ H.T - x[:, -1] @ effective.H.T)[:, 0]
    products = w[:, -1, 1] * noise
    error = float(products.std(ddof=1) / np.sqrt(len(products)))
    ours = float(effective.correlation[1, 0])
    return Numbers(-float(H[0, 1]), ours, float(products.mean()), sampling(4), error, unit="m²/s")


def _transposed(study: Study) -> Numbers:
    """(13) for a plant with both states measured, one step late, where K φ has a shape at all."""
    plant = Model(F=[[1.0, 1.0], [0.0, 1.0]], H=np.eye(2), Q=[[2.0, 2.0], [2.0, 4.0]], R=np.diag([14.0, 1.0]))
    f = DelayKalmanFilter(2, 2, max_delay=1, method="correlated")
    f.F, f.H, f.Q, f.R, f.P = plant.F, plant.H, plant.Q, plant.R, 5.0 * np.eye(2)
    f.predict()
    f.update(np.zeros(2), delay=1)
    K, Hb = np.asarray(f.K), plant.H @ power(plant.F, -1)
    kept, phi = np.eye(2) - K @ Hb, -plant.Q @ Hb.T
    Rb = plant.R + Hb @ plant.Q @ Hb.T
    prior = plant.F @ (5.0 * np.eye(2)) @ plant.F.T + plant.Q
    printed = kept @ prior @ kept.T + K @ Rb @ K.T - kept @ phi @ K.T - K @ phi @ kept.T
    rng, count = study.rng("transposed"), study.choose(40_000, 400_000)
    before = np.sqrt(5.0) * rng.standard_normal((count, 2))
    w = rng.multivariate_normal(np.zeros(2), plant.Q, count)
    v = rng.multivariate_normal(np.zeros(2), plant.R, count)
    error = before @ plant.F.T + w
    error = error - (before @ plant.H.T + v) @ K.T
    mean, spread = variance(error[:, 0])
    return Numbers(float(printed[0, 0]), float(f.P[0, 0]), mean, sampling(4), spread)


def _one_sided(study: Study) -> Numbers:
    """(25) over a window of 8 without delay, where its last term is read as G H' R H G."""
    horizon = 8
    C = np.vstack([H @ power(F, -(1 - i)) for i in range(2)])
    G = np.linalg.inv(C.T @ C)
    P = G @ C.T @ np.kron(np.eye(2), R) @ C @ G
    for _ in range(horizon - 2):
        G = np.linalg.inv(H.T @ H + np.linalg.inv(F @ G @ F.T))
        P = (np.eye(4) - G @ H.T @ H) @ (F @ P @ F.T - Q) + G @ H.T @ R @ H @ G
    f = UFIRFilter(4, 2, horizon=horizon)
    f.F, f.H, f.Q, f.R = F, H, Q, R
    for _ in range(2 * horizon):
        f.predict()
        f.update(np.zeros(2))
    x, _ = paths(study.rng("window"), MODEL, horizon, study.choose(40_000, 400_000))
    z = x @ H.T + study.rng("noise").normal(0.0, np.sqrt(R[0, 0]), (*x.shape[:2], 2))
    C = np.vstack([H @ power(F, -(horizon - 1 - i)) for i in range(horizon)])
    gain = np.linalg.lstsq(C, np.eye(len(C)), rcond=None)[0]
    errors = z[:, 1:].reshape(len(z), -1) @ gain.T - x[:, -1]
    mean, spread = variance(errors[:, 0])
    return Numbers(float(P[0, 0]), float(f.P[0, 0]), mean, sampling(4), spread, unit="m²")


ITEM: Item = errata_item(
    S1,
    [
        Erratum("(1), (2)", "columns of H", "H is K x M", "M x K", _columns),
        Erratum(
            "section 3",
            "RMS error of a position rebuilt three steps back",
            "x_{n-k} = F^{-k} (x_n - Σ w_{n-j})",
            "Σ F^j w_{n-j}",
            _rebuilt,
        ),
        Erratum(
            "(7)",
            "RMS error of the measurement before, rebuilt",
            "-(1 - α) H w_n",
            "-(1 - α) H F^{-1} w_n",
            _noise_term,
        ),
        Erratum(
            "(8)",
            "noise variance of a late measurement, σ_w = 8",
            "-(1 - α) H Q H', so that a variance is negative",
            "+(1 - α) H F^{-1} Q F^{-T} H'",
            _indefinite,
        ),
        Erratum(
            "(9)",
            "mean square difference of a repeated measurement",
            "H x_{n-1} + v_n",
            "H x_{n-1} + v_{n-1}: the same number again, to be dropped",
            _repeat,
        ),
        Erratum(
            "(10)",
            "how the measurement east depends on the position north",
            "third term without H",
            "(1 - α0)(1 - (1 - α0')α1) H, or, as here, no row for a loss",
            _scalar_term,
        ),
        Erratum(
            "(11), (12)",
            "noise variance on the branch of the delay",
            "w on the branch of the prediction, with a minus",
            "on the branch of the delay, + H F^{-1} Q F^{-T} H'",
            _delay_branch,
        ),
        Erratum(
            "φ",
            "E[w v̄'] of velocity noise and position",
            "-(1 - α) H",
            "-(1 - α) Q F^{-T} H'",
            _correlation,
        ),
        Erratum(
            "(13)",
            "error variance after one late update, two states measured",
            "last term K φ (I - K H̄)'",
            "K φ' (I - K H̄)'",
            _transposed,
        ),
        Erratum(
            "(19), (20)",
            "position of a car without noise, n = 20",
            "rows H̄_{m+1} F², F^{n-1}",
            "row i is H̄_{m+i} F^i, the last one F^{N-1}",
            windows.exponents,
        ),
        Erratum(
            "(22)",
            "position of a car without noise, one step late",
            "H̄ F^{-N+1-k}: the delay counts twice",
            "H F^{-N+1-k} or H̄ F^{-N+1}",
            windows.twice,
        ),
        Erratum(
            "(25)",
            "position variance without delay, N = 8",
            "(I - G H'H)(F P F' - Q), one-sided",
            "(I - G H'H)(F P F' + Q)(I - G H'H)'",
            _one_sided,
        ),
    ],
    "(1), (2) exchange the names of the two noises; (16) is P_n, not P⁻_n; (24) has Y where D is meant; "
    "section 4.1 exchanges Figs 4 and 5.",
)
