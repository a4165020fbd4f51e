"""The exact Kalman recursion for measurements that come late, without a larger state.

A measurement of x_{n-k} is one of x_n whose noise holds the process noises since (`Channel.effective`). The
filter's error holds the same noises, so it keeps their covariances E[e_n w_j'] for as many steps as a
measurement can be late, and its P is the true error covariance: equation :eq:`exact-delay`.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from .._arrays import Array
from ..channels import Effective, Step
from .kalman import Posterior, predict, update

__all__ = ["Correlation", "Delayed", "corrected", "cross_covariance", "predict_delayed", "update_delayed"]

Correlation = Literal["exact", "correlated", "white"]


class Delayed(NamedTuple):
    """State and covariance, and what a late measurement needs to know of the past.

    Attributes
    ----------
    x : ndarray, (dim_x,) or (dim_x, 1)
    P : ndarray, (dim_x, dim_x)
    E : tuple of ndarray, (dim_x, dim_x)
        E[i] is the covariance of the error with the process noise i steps ago, newest first.
    past : tuple of Step
        The transitions those noises belong to, newest last.
    """

    x: Array
    P: Array
    E: tuple[Array, ...] = ()
    past: tuple[Step, ...] = ()


def predict_delayed(
    state: Delayed, F: Array, Q: Array, Bu: Array | None = None, *, depth: int, fading: float = 1.0
) -> Delayed:
    """One step ahead, remembering the last `depth` process noises:  E_j <- F E_j,  E_newest = Q.

    Fading memory magnifies the error, and so its covariances with the noises, by sqrt(fading).
    """
    x, P = predict(state.x, state.P, F, Q, Bu, fading)
    if depth == 0:
        return Delayed(x, P)
    magnified = F if fading == 1.0 else np.sqrt(fading) * F
    older = [magnified.dot(E) for E in state.E[: depth - 1]]
    return Delayed(x, P, (Q, *older), (*state.past, Step(F, Q, Bu))[-depth:])


def update_delayed(
    state: Delayed, z: Array, row: Effective, correlation: Correlation = "exact", cross: Array | None = None
) -> tuple[Delayed, Posterior]:
    """Take in a measurement that `row` expresses by the present state.

    Parameters
    ----------
    state : Delayed
        Prior, from `predict_delayed` or an earlier update of the same step.
    z : ndarray, (dim_z,) or (dim_z, 1), like state.x
    row : Effective
        Of the measurement's delay, from a channel.
    correlation : {"exact", "correlated", "white"}, optional
        How much of the correlation between the error and the measurement's noise is taken into account: all
        of it; that with the newest process noise only (phi of Uribe-Murcia et al. 2022); none (Uribe-Murcia
        et al. 2018). P is the true error covariance for the first only.
    cross : ndarray, (dim_x, dim_z), optional
        Covariance of the error with the measurement's own noise, beside that through the process noises.

    Returns
    -------
    Delayed, Posterior

    Notes
    -----
    Ph = -sum_{i<k} E_{n-i} G_i',  K and P as in `update` with cross = Ph, and
    E_j <- (I - K Hb) E_j + K G_{n-j} Q_j.
    """
    cross = cross_covariance(state, row, correlation, cross)
    z = z + row.offset.reshape(z.shape)
    posterior = update(state.x, state.P, z, row.H, row.R, cross)
    return corrected(state, posterior, row.H, row.G), posterior


def corrected(state: Delayed, posterior: Posterior, H: Array, G: tuple[Array, ...] = ()) -> Delayed:
    """The memory after an update:  E_j <- (I - K H) E_j + K G_{n-j} Q_j."""
    K = posterior.K
    kept = [E - K.dot(H.dot(E)) for E in state.E]
    for i, late in enumerate(G[: len(kept)]):
        kept[i] = kept[i] + K.dot(late).dot(state.past[-1 - i].Q)
    return Delayed(posterior.x, posterior.P, tuple(kept), state.past)


def cross_covariance(
    state: Delayed, row: Effective, correlation: Correlation = "exact", cross: Array | None = None
) -> Array | None:
    """E[e v'] of the prior error with the noise of `row`, as far as `correlation` takes it into account."""
    for E, G in zip(state.E, _known(row, correlation), strict=False):
        part = E.dot(G.T)
        cross = -part if cross is None else cross - part
    return cross


def _known(row: Effective, correlation: Correlation) -> tuple[Array, ...]:
    """The parts of the noise whose correlation with the error is used."""
    if correlation == "exact":
        return row.G
    return row.G[:1] if correlation == "correlated" else ()
