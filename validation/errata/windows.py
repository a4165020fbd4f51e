"""A car without noise and what a printed regression over its window makes of it: S1 and S2 share these."""

from __future__ import annotations

import numpy as np

from ufirext import Model, UFIRFilter
from validation.claims import absolute
from validation.errata.erratum import Numbers
from validation.errata.literal import Array, power
from validation.study import Study
from validation.vehicle import vehicle

__all__ = ["SPEED", "exponents", "straight", "twice"]

MODEL: Model = vehicle()
N = 5
SPEED = 10.0
NOW = 20
"""The step n of the papers' F^{n-1}, of which 1 <= n <= N would be right."""


def straight(steps: int) -> Array:
    """True states of a car that drives east at 10 m/s from the origin, (steps, 4)."""
    return np.array([[SPEED * n, SPEED, 0.0, 0.0] for n in range(steps)])


def _ours(H: Array, delay: int) -> float:
    """The library's position at step NOW."""
    f = UFIRFilter(4, 2, horizon=N)
    f.F, f.H, f.R = MODEL.F, H, MODEL.R
    states = straight(NOW + 1)
    for n in range(NOW + 1):
        f.predict()
        if n >= delay:
            f.update(H @ states[n - delay], delay=delay)
    return float(np.ravel(f.x)[0])


def exponents(study: Study) -> Numbers:
    """x_m by the printed C_{m,n}, moved to n: rows H, H F, H F^2, .. and H F^{n-1} in the end."""
    F, H = MODEL.F, MODEL.H
    C = np.vstack([H @ power(F, i) for i in (*range(N - 1), NOW - 1)])
    data = (straight(NOW + 1)[-N:] @ H.T).reshape(-1)
    x_m = np.linalg.lstsq(C, data, rcond=None)[0]
    printed = float((power(F, N - 1) @ x_m)[0])
    return Numbers(printed, _ours(H, 0), SPEED * NOW, absolute(1e-8), unit="m")


def twice(study: Study) -> Numbers:
    """One step of delay in both factors of H̄ F^{-N+1-k}."""
    F, H = MODEL.F, MODEL.H
    Hb = H @ power(F, -1)
    C = np.vstack([Hb @ power(F, -(N - 1 - i) - 1) for i in range(N)])
    data = (straight(NOW)[-N:] @ H.T).reshape(-1)
    printed = float(np.linalg.lstsq(C, data, rcond=None)[0][0])
    return Numbers(printed, _ours(H, 1), SPEED * NOW, absolute(1e-8), unit="m")
