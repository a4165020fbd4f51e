"""FIR estimators of a plant, and how every signal enters them: gains on y and u, responses to noise.

UFIR and FMS differ in the process noise that the design counts on, none or QN: unbiased least squares is the
minimum-variance unbiased gain of a plant without process noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import control as ct
import numpy as np
from numpy.typing import ArrayLike

from .._arrays import Array, integer, symmetric
from ..gains import require_determined
from ..horizon import best_horizon
from ..joint import joint_gain, require_definite, square_root
from ..model import Model
from ..prefixes import start_length
from ..window import Window, whitener
from .plant import Plant

__all__ = ["Design", "Form", "checked_form", "fms_design", "require_no_loop", "ufir_design", "ufir_horizon"]

Form = Literal["predictor", "filter"]


@dataclass(frozen=True)
class Design:
    """An FIR estimator, oldest instant first.

    Attributes
    ----------
    K : ndarray, (dim_x, horizon, dim_z)
        Gain on the measurements (less D u).
    L : ndarray, (dim_x, steps, dim_u)
        Gain on the known inputs that lead from each instant of the window to the next; `steps` is horizon for
        a predictor, whose last input leads to the state that is predicted, and horizon - 1 for a filter.
    E : ndarray, (dim_x, steps, dim_x)
        Response of the error x - xhat to what disturbs the state on the way to the next instant.
    horizon, lag : int
    form : {"predictor", "filter"}
    """

    K: Array
    L: Array
    E: Array
    horizon: int
    lag: int
    form: Form

    @property
    def gain(self) -> Array:
        """K as a matrix, (dim_x, horizon * dim_z)."""
        return self.K.reshape(len(self.K), -1)

    def covariance(self, Q: Array, R: Array) -> Array:
        """Error covariance under state noise Q and measurement noise R."""
        P = np.einsum("ajb,bc,djc->ad", self.E, Q, self.E) + np.einsum("ajb,bc,djc->ad", self.K, R, self.K)
        return symmetric(P)


def checked_form(form: str) -> Form:
    """The form, or ControlArgument."""
    for known in get_args(Form):
        if form == known:
            return known  # type: ignore[no-any-return]
    raise ct.ControlArgument(f"unknown form '{form}'; expected 'predictor' (from y up to k - 1) or 'filter'")


def require_no_loop(plant: Plant, form: Form, feedthrough: bool) -> None:
    """Refuse a filter of a plant with D != 0, unless the caller knows that it closes no algebraic loop."""
    if form == "filter" and plant.D.any() and not feedthrough:
        raise NotImplementedError(
            "form='filter' with nonzero 'D' matrix: xhat[k] needs u[k], and u[k] = -K xhat[k] needs xhat[k], "
            "an algebraic loop; use form='predictor', which takes any D, or feedthrough=True where u is not "
            "made from xhat"
        )


def ufir_design(plant: Plant, RN: ArrayLike | None, horizon: int, lag: int, form: Form) -> Design:
    """Least squares over the window, rows weighted by RN^-1."""
    return _design(plant, plant.model(None, RN), np.zeros((plant.dim_x, 0)), horizon, lag, form)


def fms_design(plant: Plant, QN: ArrayLike, RN: ArrayLike, horizon: int, lag: int, form: Form) -> Design:
    """Minimum variance over the window under QN and RN."""
    model = plant.model(QN, RN)
    require_definite(model.R, "RN")
    return _design(plant, model, plant.G @ square_root(plant.process_noise(QN)), horizon, lag, form)


def _design(plant: Plant, model: Model, root: Array, horizon: int, lag: int, form: Form) -> Design:
    n, predicts = plant.dim_x, form == "predictor"
    horizon = integer(horizon, "horizon", 1)
    newest = horizon if predicts else horizon - 1
    lag = integer(lag, "lag", 0, newest, f"the window of {horizon} steps reaches no further back")
    window = Window(
        F=[model.F] * newest,
        Q=[model.Q] * newest,
        H=[model.H] * horizon,
        R=[model.R] * horizon,
        origins=range(horizon),
        aim=newest - lag,
        whiteners=[whitener(model.R)] * horizon,
    )
    if start_length(window, n + 1) is None:
        require_determined(window, model, horizon)
    # Noise on the state goes the ways of an input that the estimator is not told of.
    entries = np.hstack([plant.B, np.eye(n)])
    joint = joint_gain(window, [entries] * newest, [root] * newest)
    responses = joint.L[n:].reshape(n, newest, entries.shape[1])
    return Design(
        K=joint.K[n:].reshape(n, horizon, plant.dim_z),
        L=responses[:, :, : plant.dim_u],
        E=responses[:, :, plant.dim_u :],
        horizon=horizon,
        lag=lag,
        form=form,
    )


def ufir_horizon(plant: Plant, horizon: int | str, QN: ArrayLike | None, RN: ArrayLike | None) -> int:
    """The horizon asked for, or with "auto" the best one under QN and RN."""
    if isinstance(horizon, str) and horizon == "auto":
        if QN is None or RN is None:
            raise ct.ControlArgument(
                'horizon="auto" weighs process against measurement noise: give QN and RN'
            )
        return best_horizon(plant.model(QN, RN))
    return integer(horizon, "horizon", 1)
