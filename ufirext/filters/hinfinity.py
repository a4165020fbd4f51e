"""DelayHInfinityFilter: the H-infinity filter behind filterpy's verbs, with a guarantee that is checked."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .._arrays import Array, integer, one_of
from ..channels import Channel
from ..diagnostics import Guarantee, WorstCase
from ..errors import UfirextError
from ..recursions.hinfinity import Form
from ._arguments import dimensions, late_channel, require_filter
from ._describe import describe
from ._robust import RobustState, Theta, checked_theta
from .kalman import LateFilter

__all__ = ["DelayHInfinityFilter"]

FORMS = ("posterior", "prior", "mixed")
ON_VIOLATION = ("raise", "clip")
TAKEN_OVER = ("dim_x", "dim_z", "dim_u", "F", "H", "P", "x", "B", "gamma", "Q", "W", "V")


class RenamedAttribute(UfirextError, AttributeError):
    """An attribute has another name here; also an AttributeError, as `hasattr` expects."""


class _Renamed:
    """A name of filterpy's HInfinityFilter that means nothing here: assigned, it would pass in silence."""

    def __init__(self, here: str) -> None:
        self.here = here

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, instance: object, owner: type | None = None) -> _Renamed:
        if instance is None:
            return self
        raise self._error()

    def __set__(self, instance: object, value: object) -> None:
        raise self._error()

    def _error(self) -> RenamedAttribute:
        return RenamedAttribute(f"filterpy's {self.name} is {self.here}; from_filterpy takes it over")


class DelayHInfinityFilter(LateFilter):
    """H-infinity filter: the weighted energy of its errors is bounded for every disturbance, random or not.

    ``sum theta_n |e_n|^2_S <= |x_0 - x^_0|^2_{P0^-1} + sum |w_n|^2_{Q^-1} + sum |v_n|^2_{R^-1}``, also with
    measurements that come late, out of order, in part or not at all, equation :eq:`guarantee`. The surface is
    that of ``filterpy.kalman.KalmanFilter``; `from_filterpy` takes over a
    ``filterpy.hinfinity.HInfinityFilter``, whose author asks not to use it.

    Parameters
    ----------
    dim_x, dim_z : int
        Numbers of states and of measured components.
    dim_u : int, optional
        Number of inputs, 0 for any.
    theta : "auto", float, sequence or callable
        How much is guaranteed: 0 is the Kalman filter, more bounds the errors more tightly, and from
        `theta_max` on there is no such filter. "auto" keeps `fraction` of theta_max at each step
        that brings a measurement and 0 at the others. A sequence holds the theta of steps 1, 2, .. (the last
        one goes on), a callable returns that of its step.
    form : {"posterior", "prior"}
        Which error is bounded: x_n - x^_n after the update, or x_n - F x^_{n-1} before it, which asks more.
        "mixed" is the pairing in Uribe-Murcia et al. (2018), for reproduction only: it bounds neither.
    S : array_like, (dim_x, dim_x), or scalar, optional
        Weight of the errors, positive semidefinite. Default identity. Attribute `weight` (filterpy's S is the
        innovation covariance).
    on_violation : {"raise", "clip"}
        Where theta is not below theta_max: `ThetaTooLarge`, which leaves the filter as it was, or this step's
        theta is fraction * theta_max.
    fraction : float, optional
        Share of theta_max that "auto" and "clip" use, between 0 and 1.
    max_delay : int, optional
        The oldest measurement that is taken, in steps; short for ``channel=TimeStamped(max_delay)``. The
        filter then works on [x_n; x_{n-1}; ..], where the bound holds for the true noises.
    channel : Channel, optional
        What the network does to measurements.

    Attributes
    ----------
    x, P, F, H, Q, R, B, K, y, S, SI, z, x_prior, P_prior, x_post, P_post
        As in filterpy. Q, R and the initial P are the weights of the disturbances. P after an update is what
        the next prediction starts from, (P_prior^-1 - theta S + H'R^-1H)^-1; it is the covariance of Gaussian
        errors for theta = 0 only.

    Raises
    ------
    ThetaTooLarge
        From `update` and `predict`, with the step and theta_max. Each update of a step is judged:
        measurements that are too little one by one can be given in one call, with stacked H and R.
    UfirextError
        For bad options.
    ShapeError
        For a dimension that is none; from the verbs, for arrays that do not fit.

    Notes
    -----
    Simon, Optimal State Estimation (2006), chapter 11, in a form that inverts neither P nor Q.

    Examples
    --------
    >>> import numpy as np
    >>> from ufirext import DelayHInfinityFilter
    >>> f = DelayHInfinityFilter(dim_x=2, dim_z=1, theta=0.01)
    >>> f.F, f.H = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    >>> f.Q = 0.1 * np.eye(2)
    >>> for n in range(50):
    ...     f.predict()
    ...     f.update(3.0 * n)
    >>> f.x.round(1).ravel()
    array([147.,   3.])
    >>> f.guarantee.holds
    True
    """

    W = _Renamed("Q here, its Q is weight")
    V = _Renamed("R here")
    gamma = _Renamed("theta here")

    _state: RobustState

    def __init__(
        self,
        dim_x: int,
        dim_z: int,
        dim_u: int = 0,
        *,
        theta: Theta = "auto",
        form: str = "posterior",
        S: ArrayLike | None = None,
        on_violation: str = "raise",
        fraction: float = 0.3,
        max_delay: int = 0,
        channel: Channel | None = None,
    ) -> None:
        dim_x, dim_z, dim_u = dimensions(dim_x, dim_z, dim_u)
        one_of(form, FORMS, "form")
        one_of(on_violation, ON_VIOLATION, "on_violation")
        if not 0.0 < checked_theta(fraction, "fraction") < 1.0:
            raise UfirextError(f"fraction must lie between 0 and 1, got {fraction!r}")
        known: Form = "posterior" if form == "posterior" else "prior" if form == "prior" else "mixed"
        state = RobustState(
            dim_x,
            dim_z,
            late_channel(channel, max_delay),
            _checked_policy(theta),
            known,
            on_violation == "clip",
            float(fraction),
        )
        super().__init__(dim_x, dim_z, dim_u, state)
        if S is not None:
            self.weight = S

    @classmethod
    def from_filterpy(cls, hinf: Any, **options: Any) -> DelayHInfinityFilter:
        """The filter that a filterpy HInfinityFilter stands for: its W is Q, its V is R, its Q the weight S.

        Parameters
        ----------
        hinf : filterpy.hinfinity.HInfinityFilter
            Configured; its gamma is theta.
        **options
            Keywords of DelayHInfinityFilter; theta takes the place of gamma.

        Raises
        ------
        TypeError
            For an object that lacks them, with their names.
        """
        require_filter(hinf, "hinf", "filterpy.hinfinity.HInfinityFilter", TAKEN_OVER)
        hinf = copy.deepcopy(hinf)  # edits of its arrays are its own
        options = {"theta": hinf.gamma, "S": hinf.Q, **options}
        new = cls(hinf.dim_x, hinf.dim_z, hinf.dim_u or 0, **options)
        new.F, new.H, new.P, new.x = hinf.F, hinf.H, hinf.P, hinf.x
        new.Q, new.R = hinf.W, hinf.V
        if np.ndim(hinf.B) == 2:
            new.B = hinf.B
        return new

    # -- the guarantee --------------------------------------------------------------------

    @property
    def theta(self) -> Theta:
        """What was asked: a number, "auto", a sequence or a callable; assign another one at any time."""
        return self._state.theta

    @theta.setter
    def theta(self, value: Theta) -> None:
        policy = _checked_policy(value)
        self._state.settle()
        self._state.theta = policy

    @property
    def theta_used(self) -> float | None:
        """The theta of the present step, None as long as it is open: until the next update; a theta that was
        given is settled by `predict` where it bounds the error before the update.
        """
        self._state.look()
        account = self._state.account
        return None if account is None else account.lowest

    @property
    def theta_max(self) -> float:
        """The limit of the present step, as it stands: below it the bound exists."""
        state = self._state
        state.look()
        return state.limit() if state.account is None else state.account.limit

    @property
    def form(self) -> str:
        """Which error is bounded."""
        return self._state.robust_form

    @property
    def weight(self) -> Array:
        """S, the weight of the errors, (dim_x, dim_x)."""
        self._state.settle()
        self._state.watching = True
        return self._state.weight.hand_out()

    @weight.setter
    def weight(self, value: ArrayLike) -> None:
        self._state.settle()
        self._state.weight.assign(value)
        self._state.watching |= self._state.weight.handed is not None

    @property
    def guarantee(self) -> Guarantee:
        """Which error is bounded, by what, for which disturbances, over the steps so far."""
        self._state.look()
        total, channel = self._state.total, self.channel
        return Guarantee(
            self._state.robust_form,
            total.steps,
            (min(total.lowest, total.highest), total.highest),
            total.limit,
            total.clipped,
            channel.max_delay,
            not channel.stamped,
        )

    def worst_case_gain(self, steps: int, delay: int = 0) -> WorstCase:
        """What the worst disturbance of the coming steps does to the errors, by singular values.

        Parameters
        ----------
        steps : int
            At least 1; every measurement of these steps comes, `delay` steps late.
        delay : int, optional
            0..max_delay.

        Returns
        -------
        WorstCase
            ``.gain`` is ``sup sum theta |e|^2_S / (energy of the disturbances)``, at most 1 where there is a
            guarantee; ``.x0``, ``.w``, ``.v`` attain it, with delays on [x_n; x_{n-1}; ..].

        Raises
        ------
        ThetaTooLarge
        UfirextError
            Behind a channel without time stamps, whose rows depend on what is measured until then.
        """
        if not self.channel.stamped and self.max_delay:
            raise UfirextError(
                f"the coming rows must be known, behind {self.channel} they depend on what is measured; "
                "ask a filter with max_delay=1"
            )
        state = copy.deepcopy(self._state)
        state.settle()
        return state.worst_case(integer(steps, "steps", 1), self.channel.check_delay(delay))

    def __repr__(self) -> str:
        return describe(self, extra=("form", "theta", "theta_max", "max_delay", "guarantee"))


def _checked_policy(theta: Any) -> Theta:
    """A theta as asked for, its numbers checked."""
    if callable(theta) or (isinstance(theta, str) and theta == "auto"):
        asked: Theta = theta
        return asked
    if isinstance(theta, str):
        raise UfirextError(f"theta must be 'auto', a number, a sequence or a callable, got {theta!r}")
    if isinstance(theta, Sequence) or np.ndim(theta):
        values = [checked_theta(value, f"theta[{i}]") for i, value in enumerate(theta)]
        if not values:
            raise UfirextError("theta must hold at least one number, got none")
        return values
    return checked_theta(theta)
