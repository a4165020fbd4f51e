"""The least-squares window gain and its exact covariance in as many digits as it takes (mpmath)."""

from __future__ import annotations

import mpmath
import numpy as np

from ufirext import Model


def reference(model: Model, horizon: int, lag: int = 0, digits: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """K = T (C'R^-1C)^-1 C'R^-1 and P = sum D Q D' + sum g R g', rounded to doubles at the very end."""
    with mpmath.workdps(digits):
        F, H, Q, R = (mpmath.matrix(a.tolist()) for a in (model.F, model.H, model.Q, model.R))
        eye = mpmath.eye(model.dim_x)
        weight = mpmath.inverse(R)
        rows = [H]
        for _ in range(horizon - 1):
            rows.append(rows[-1] * F)
        information = mpmath.zeros(model.dim_x)
        for row in rows:
            information += row.T * weight * row
        aim = eye
        for _ in range(horizon - 1 - lag):
            aim = F * aim
        spread = aim * mpmath.inverse(information)
        gains = [spread * row.T * weight for row in rows]
        path, P = mpmath.zeros(model.dim_x), mpmath.zeros(model.dim_x)
        for time in range(horizon - 1, 0, -1):
            path = path * F - gains[time] * H
            if time == horizon - 1 - lag:
                path += eye
            P += path * Q * path.T
        for gain in gains:
            P += gain * R * gain.T
        K = np.hstack([np.array(gain.tolist(), dtype=float) for gain in gains])
        return K, np.array(P.tolist(), dtype=float)
