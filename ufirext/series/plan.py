"""Everything that a constant model, a horizon and a lag determine before a series is seen."""

from __future__ import annotations

from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from .._arrays import Array, covariance, lag_within, shown
from ..errors import UfirextError
from ..gains import Gain, horizon_count, ufir_gain
from ..minimum_variance import minimum_variance_gain
from ..model import Model, require_model
from .growth import Head, head_of, head_states
from .inputs import input_gain, trajectory
from .summed import Summed
from .toeplitz import Convolution, convolution, convolve, piece

__all__ = ["SeriesPlan", "model_with", "series_plan"]


class SeriesPlan:
    """How a whole series of a constant model is filtered; made by `series_plan`, cached, and shared.

    Attributes
    ----------
    model : Model
        With the Q and R that the gains are for.
    horizon, lag : int
        The estimate of step n is that of the state `lag` steps before, from the last `horizon` measurements.
    unbiased : bool
        True for UFIR, False for minimum variance.
    gain : Gain
        Of the full window.
    convolution : Convolution
        The matrices of the products that filter full windows: what `kernel` takes.
    alignment : int
        Chunks of a series that begin at multiples of it, and are preceded by `aligned_reach` samples, have
        the same bits as the whole series has.

    Examples
    --------
    >>> from ufirext import kinematic
    >>> from ufirext.series import series_plan
    >>> series_plan(kinematic(1, 1, 0.1), 300)
    SeriesPlan(UFIR, dim_x=2, dim_z=1, horizon=300, lag=0
      first estimate after 2 steps, full windows after 300
      full windows: blocks of 12 outputs, 2 levels, 64 multiplications a step (direct: 600)
      alignment 32760, reach 299)
    """

    kernel = staticmethod(convolve)

    def __init__(self, model: Model, horizon: int, lag: int, unbiased: bool) -> None:
        self.model, self.horizon, self.lag, self.unbiased = model, horizon, lag, unbiased
        self.gain: Gain = (ufir_gain if unbiased else minimum_variance_gain)(model, horizon, lag)

    def __reduce__(self) -> tuple[object, ...]:
        return (_shared_plan, (self.model, self.horizon, self.lag, self.unbiased))

    @cached_property
    def convolution(self) -> Convolution:
        """The full window's gain as a convolution."""
        n, m = self.model.dim_x, self.model.dim_z
        return convolution(np.ascontiguousarray(self.gain.K.reshape(n, -1, m).transpose(1, 2, 0)))

    @cached_property
    def summed(self) -> Summed:
        """The convolution of measurements, (T, dim_z), for NumPy."""
        return Summed(self.convolution)

    @cached_property
    def with_inputs(self) -> Summed:
        """The same for measurements and known inputs side by side, (T, dim_z + dim_u)."""
        n, model = self.model.dim_x, self.model
        taps = np.zeros((self.horizon, model.dim_z + model.dim_u, n))
        taps[:, : model.dim_z] = self.gain.K.reshape(n, -1, model.dim_z).transpose(1, 2, 0)
        # The input of a step leads to its state: that of the window's oldest step is outside.
        L = input_gain(model, self.gain, self.unbiased)
        taps[1:, model.dim_z :] = L.reshape(n, self.horizon - 1, model.dim_u).transpose(1, 2, 0)
        return Summed(convolution(taps))

    @cached_property
    def head(self) -> Head | None:
        """The windows that are not full yet; None where only a filter that goes step by step has them."""
        if self.horizon == 1:
            return None
        return head_of(self.model, self.horizon - 1, self.lag, self.unbiased)

    def head_states(self, z: Array, us: Array | None = None) -> Array:
        """Estimates of the first steps (.., T, dim_x), T < horizon; NaN where there is none."""
        if self.head is None:
            raise RuntimeError("this plan has no head")
        if us is None:
            return np.asarray(head_states(self.head, z))
        # x = x_u + x_f: a trajectory that the inputs alone lead along, and what the rest of z says.
        path = trajectory(self.model, us)
        states: Array = np.asarray(head_states(self.head, z - path @ self.model.H.T))
        states[..., self.lag :, :] += path[..., : path.shape[-2] - self.lag, :]
        return states

    @property
    def first(self) -> int:
        """Number of measurements after which the first estimate is there."""
        return self.horizon if self.head is None else min(self.head.first, self.horizon)

    @property
    def alignment(self) -> int:
        """Chunks that begin at multiples of it have the bits of the whole series."""
        op = self.convolution
        return max(1, piece(op.inputs, op.outputs) // op.block) * op.block

    def reach(self, lag: int | None = None, max_delay: int = 0) -> int:
        """Samples before a chunk that its estimates depend on: horizon - 1 + lag + the largest delay."""
        return self.horizon - 1 + (self.lag if lag is None else lag) + max_delay

    def aligned_reach(self, lag: int | None = None, max_delay: int = 0) -> int:
        """`reach`, rounded up to a multiple of the alignment."""
        return -(-self.reach(lag, max_delay) // self.alignment) * self.alignment

    def __repr__(self) -> str:
        op, kind = self.convolution, "UFIR" if self.unbiased else "minimum variance"
        direct = op.inputs * op.outputs * self.horizon
        sizes = f"dim_x={self.model.dim_x}, dim_z={self.model.dim_z}"
        return (
            f"SeriesPlan({kind}, {sizes}, horizon={self.horizon}, lag={self.lag}\n"
            f"  first estimate after {self.first} steps, full windows after {self.horizon}\n"
            f"  full windows: blocks of {op.block} outputs, {op.levels} level{'s' if op.far else ''}, "
            f"{op.multiplications:.0f} multiplications a step (direct: {direct})\n"
            f"  alignment {self.alignment}, reach {self.reach()})"
        )


def series_plan(
    model: Model,
    horizon: int | str,
    lag: int = 0,
    noise: tuple[ArrayLike, ArrayLike] | None = None,
    *,
    unbiased: bool | None = None,
) -> SeriesPlan:
    """The plan of a constant model, from a cache.

    Parameters
    ----------
    model : Model
    horizon : int or "auto"
    lag : int
    noise : None or (Q, R)
        As in `filter_series`.
    unbiased : bool, optional
        Overrides what `noise` says: False is minimum variance under the model's own Q and R.

    Returns
    -------
    SeriesPlan

    Raises
    ------
    HorizonError, UnobservableWindow
        As `ufir_gain`.

    Examples
    --------
    >>> from ufirext import kinematic, series_plan
    >>> plan = series_plan(kinematic(1, 1, 0.1), horizon=300)
    >>> plan.gain.horizon, plan is series_plan(kinematic(1, 1, 0.1), horizon=300)
    (300, True)
    """
    require_model(model)
    horizon = chosen_horizon(model, horizon)
    lag = lag_within(horizon, lag)
    return _shared_plan(
        model_with(model, noise), horizon, lag, noise is None if unbiased is None else unbiased
    )


def chosen_horizon(model: Model, horizon: int | str) -> int:
    """`horizon` as an int; "auto" is `best_horizon` of the model."""
    if isinstance(horizon, str) and horizon == "auto":
        from ..horizon import best_horizon

        return best_horizon(model)
    return horizon_count(horizon, model)


def model_with(model: Model, noise: tuple[ArrayLike, ArrayLike] | None) -> Model:
    """The model with the Q and R of `noise`, if there are any."""
    if noise is None:
        return model
    try:
        Q, R = noise
    except (TypeError, ValueError):
        raise UfirextError(f"noise must be a pair (Q, R), got {shown(noise)}") from None
    return model.replace(
        Q=covariance(Q, model.dim_x, "noise[0] (Q)", "(dim_x, dim_x)"),
        R=covariance(R, model.dim_z, "noise[1] (R)", "(dim_z, dim_z)"),
    )


@lru_cache(maxsize=64)
def _shared_plan(model: Model, horizon: int, lag: int, unbiased: bool) -> SeriesPlan:
    return SeriesPlan(model, horizon, lag, unbiased)
