"""Errata of Uribe-Murcia et al. (2019)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from filterpy.kalman import KalmanFilter

from ufirext import BernoulliDelay, DelayKalmanFilter, UFIRFilter
from validation.claims import absolute, sampling
from validation.errata import windows
from validation.errata.erratum import Erratum, Numbers, errata_item
from validation.errata.literal import power, settled_ours, variance
from validation.item import Item
from validation.papers import S2
from validation.study import Study
from validation.vehicle import vehicle

__all__ = ["ITEM"]

MODEL = vehicle()
F, H, Q, R = MODEL.F, MODEL.H, MODEL.Q, MODEL.R
GAMMA, SPEED, LOST = 0.8, 10.0, 20


def _noise_size(study: Study) -> Numbers:
    return Numbers(MODEL.dim_x, len(R), len(H), absolute(0.0))


def _lost(study: Study) -> Numbers:
    """Position variance after 20 losses, with and without the fiction that a prediction measures."""
    peer = KalmanFilter(4, 2)
    ours = DelayKalmanFilter(4, 2)
    for f in (peer, ours):
        f.F, f.H, f.Q, f.R, f.P = F, H, Q, R, settled_ours(MODEL, 100.0, 50).P
        for _ in range(LOST):
            f.predict()
            f.update(None)
    printed = settled_ours(MODEL, 100.0, 50 + LOST)
    return Numbers(float(printed.P[0, 0]), float(ours.P[0, 0]), float(peer.P[0, 0]), unit="m²")


def _averaged_noise(study: Study) -> Numbers:
    """Noise variance of the averaged measurement of a car at 10 m/s."""
    Hd = H @ power(F, -1)
    printed = R + (1 - GAMMA) ** 2 * Hd @ Q @ Hd.T
    start = np.array([0.0, SPEED, 0.0, 0.0])
    ours = BernoulliDelay(GAMMA).effective(MODEL, x=F @ start, P=Q)
    rng, count = study.rng("averaged"), study.choose(100_000, 1_000_000)
    x = F @ start + rng.multivariate_normal(np.zeros(4), Q, count)
    on_time = rng.random(count) < GAMMA
    z = np.where(on_time, x[:, 0], start[0]) + rng.normal(0.0, np.sqrt(R[0, 0]), count)
    mean, error = variance(z - x @ ours.H[0])
    return Numbers(float(printed[0, 0]), float(ours.R[0, 0]), mean, sampling(4), error, unit="m²")


def _own_row(study: Study) -> Numbers:
    """Noise variance of a row surely on time (γ = 1) where the newest has γ = 0.2."""
    Hd = H @ power(F, -1)
    printed = R + (1 - 0.2) ** 2 * Hd @ Q @ Hd.T
    ours = BernoulliDelay(1.0).effective(MODEL, x=np.zeros(4), P=Q).R
    return Numbers(float(printed[0, 0]), float(ours[0, 0]), float(R[0, 0]), unit="m²")


def _three_matrices(study: Study) -> Numbers:
    """(22), (23) with H̄ = H F^{-1} on the mean of the data, γ H x_n + (1 - γ) H x_{n-1}."""
    horizon, steps = 5, 20
    states = windows.straight(steps + 1)
    Hd = H @ power(F, -1)
    Hm = GAMMA * H + (1 - GAMMA) * Hd
    zs = [GAMMA * H @ now + (1 - GAMMA) * H @ before for before, now in pairwise(states)]
    C = np.vstack([Hd @ power(F, -(horizon - 1 - i)) for i in range(horizon)])
    printed = np.linalg.lstsq(C, np.ravel(zs[-horizon:]), rcond=None)[0]
    f = UFIRFilter(4, 2, horizon=horizon)
    f.F, f.H, f.R = F, Hm, R
    for z in zs:
        f.predict()
        f.update(z)
    return Numbers(float(printed[0]), float(np.ravel(f.x)[0]), SPEED * steps, absolute(1e-8), unit="m")


ITEM: Item = errata_item(
    S2,
    [
        Erratum("(1)", "components of v", "v in R^K", "R^M", _noise_size),
        Erratum(
            "(2), (3)",
            "position variance after 20 lost data",
            "H F x_{n-1}, the true state, and noise v, for a lost datum",
            "H F x̂_{n-1} and no noise: it carries no information",
            _lost,
        ),
        Erratum(
            "(8)",
            "noise variance at 10 m/s, γ = 0.8",
            "R + (1 - γ)² H F^{-1} Q F^{-T} H'",
            "R + (1 - γ) H F^{-1} Q F^{-T} H' and γ (1 - γ) times what the car moves in a step, squared",
            _averaged_noise,
        ),
        Erratum(
            "(15)",
            "position of a car without noise, n = 20",
            "rows H̄_{m+1} F², F^{n-1}",
            "row i is H̄_{m+i} F^i, the last one F^{N-1}",
            windows.exponents,
        ),
        Erratum(
            "(17)",
            "noise variance of a row on time, newest γ = 0.2",
            "B̄_n of the newest row in every row",
            "each row has its own",
            _own_row,
        ),
        Erratum(
            "(20), (22), (23)",
            "position of a car without noise from averaged data",
            "H F^{-k} in (20), γ H + (1 - γ) H F^{-1} in (6), H F^{-1} after (23)",
            "γ H + (1 - γ) H F^{-1} in all of them",
            _three_matrices,
        ),
    ],
    "the text to Fig. 5 says β = 2, its caption and Table II β = 0.5.",
)
