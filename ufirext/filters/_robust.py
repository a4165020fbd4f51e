"""State object of the H-infinity filter: the augmented Kalman filter, its P tilted once a step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .._arrays import Array, number
from ..channels import Channel
from ..channels.effective import at_block
from ..diagnostics import WorstCase, worst_case_gain
from ..engines.covariance import Covariance
from ..errors import UfirextError
from ..model import Model
from ..recursions.augmented import Lifted, augmented_model
from ..recursions.hinfinity import Form, ThetaTooLarge, largest_theta, robust_gain, tilted, weight_root
from ..recursions.kalman import Posterior, update
from ._checks import Covariance as CovarianceCheck
from ._late import Left, Mask
from ._lifted import LiftedState
from ._live import Live

Theta = float | str | Sequence[float] | Callable[[int], float]


@dataclass(frozen=True)
class Account:
    """What the steps so far used: their number, extremes of theta, smallest limit, how many clipped."""

    steps: int = 0
    lowest: float = np.inf
    highest: float = 0.0
    limit: float = np.inf
    clipped: int = 0

    def __add__(self, other: Account) -> Account:
        return Account(
            self.steps + other.steps,
            min(self.lowest, other.lowest),
            max(self.highest, other.highest),
            min(self.limit, other.limit),
            self.clipped + other.clipped,
        )


class RobustState(LiftedState):
    """The augmented filter whose P is tilted by theta S once a step, where the form says."""

    def __init__(
        self, dim_x: int, dim_z: int, channel: Channel, theta: Theta, form: Form, clips: bool, fraction: float
    ) -> None:
        super().__init__(dim_x, dim_z, channel)
        self.weight = Live(np.eye(dim_x), CovarianceCheck(dim_x, "weight"))
        self.theta = theta
        self.robust_form: Form = form
        self.clips, self.fraction = clips, fraction
        self.rooted: tuple[Array, Array] | None = None
        self.past_account = Account()
        self.account: Account | None = None  # of the present step, once its theta was used
        self.tilted = False  # whether the P of this step is J^-1 already
        self.bare: Array | None = None  # P of this step before it was tilted

    def _matrices(self) -> tuple[Live | None, ...]:
        return *super()._matrices(), self.weight

    def _held(self) -> Any:
        return self.tall.P, self.account, self.tilted, self.bare

    def _resume(self, held: Any, steps: int) -> None:
        P, account, self.tilted, self.bare = held
        if self.steady is not None and steps:
            step: Account = self.steady.after[1]
            self.past_account += replace(step, steps=steps, clipped=steps * step.clipped)
        self.account = account
        super()._resume(P, steps)

    def _levels(self) -> list[Array]:
        return [self.tall.P] if self.bare is None else [self.tall.P, self.bare]

    def _repeats(self) -> bool:
        return super()._repeats() and (self.theta == "auto" or isinstance(self.theta, float))

    def root(self) -> Array:
        """L with L'L = S on the newest block of the augmented state."""
        weight = self.weight.value
        if self.rooted is None or self.rooted[0] is not weight:
            root = weight_root(weight)
            tall = np.zeros((len(root), len(self.tall.x)))
            tall[:, : self.dim_x] = root
            self.rooted = (weight, tall)
        return self.rooted[1]

    def limit(self) -> float:
        """The theta below which the bound of the present step holds."""
        return largest_theta(self._settled().P, self.root())

    def judged(self, P: Array, step: int) -> Account:
        """The theta of a step whose tilted covariance is P, or a refusal."""
        limit = largest_theta(P, self.root())
        wanted = self.theta_of(step, limit)
        clipped = not wanted < limit
        if clipped:
            if not self.clips:
                raise ThetaTooLarge(wanted, limit, step)
            wanted = self.fraction * limit
        return Account(1, wanted, wanted, limit, int(clipped))

    def theta_of(self, step: int, limit: float) -> float:
        """What was asked for this step."""
        if self.theta == "auto":
            # Nothing to bound where no disturbance reaches the weighted error.
            return self.fraction * limit if np.isfinite(limit) else 0.0
        if callable(self.theta):
            return checked_theta(self.theta(step), f"theta({step})")
        if isinstance(self.theta, Sequence) and not isinstance(self.theta, str):
            return checked_theta(self.theta[min(max(step - 1, 0), len(self.theta) - 1)], "theta")
        return float(self.theta)

    # -- the steps ------------------------------------------------------------------------

    def predict(self, F: Array, Q: Array, known: Array | None) -> None:
        """Time update; a refusal leaves the filter as it was."""
        before = (self.tall, self.account, self.past_account, self.tilted, self.bare)
        try:
            super().predict(F, Q, known)
        except ThetaTooLarge:
            self.tall, self.account, self.past_account, self.tilted, self.bare = before
            raise

    def _settled(self) -> Lifted:
        if self.P is not self.own_P:
            self.bare = None
        return super()._settled()

    def _ahead(self, F: Array, Q: Array, known: Array | None) -> tuple[Array, Array]:
        x, P = super()._ahead(F, Q, known)
        self.tilted, self.bare = False, None
        if self.account is not None:
            self.past_account, self.account = self.past_account + self.account, None
        # What "auto" takes is open until something comes; a given theta bounds this error whatever comes.
        if self.robust_form == "prior" and self.theta != "auto":
            self.account = self.judged(self.tall.P, self.now + 1)
        return x, P

    def _closed(self, state: Lifted) -> Lifted:
        """The state from which the next prediction starts, if no update has tilted it yet."""
        if self.tilted or (self.now == 0 and not self.updated):
            return state
        if self.theta == "auto":
            # Errors of steps without a measurement weigh nothing, else P grew without end over a gap.
            self.account = Account(1, 0.0, 0.0)
            return state
        self.account = self.judged(state.P, self.now)
        return state._replace(P=tilted(state.P, self.root(), self.account.lowest))

    def _start(self) -> Lifted:
        """The prior of an update: P before it was tilted, where the form tilts after its measurements."""
        state = self._settled()
        if self.robust_form == "prior" and not self.tilted:
            return state._replace(P=self._tilted(state.P))
        return state if self.bare is None else state._replace(P=self.bare)

    def _taken(
        self, z: Array, H: Array, R: Array, mask: Mask | None, delay: int, cross: Array | None
    ) -> tuple[Left, Array, Array]:
        met = self._settled().P
        left, x, P = super()._taken(z, H, R, mask, delay, cross)
        if self.robust_form == "prior":
            # S is told of the P that was published, not of the tilted one.
            prior = Covariance.of(met)
            left = (*left[:5], prior, *left[6:]) if isinstance(left, tuple) else replace(left, P=prior)
        return left, x, P

    def _updated(self, state: Lifted, z: Array, H: Array, R: Array, cross: Array | None) -> Posterior:
        posterior = update(state.x, state.P, z, H, R, cross)
        if self.robust_form == "prior" or (self.tilted and self.bare is None):
            return posterior
        P = self._tilted(posterior.P)
        if self.robust_form == "mixed":
            # The other filter's gain; a second measurement of the step starts from the tilted P.
            K = np.asarray(np.linalg.solve(R, H @ P).T, dtype=float)
            return posterior._replace(x=state.x + K @ posterior.y, P=P, K=K)
        self.bare = posterior.P
        return posterior._replace(P=P)

    def _tilted(self, P: Array) -> Array:
        self.account = self.judged(P, self.now)
        self.tilted = True
        return tilted(P, self.root(), self.account.lowest)

    def _nothing(self) -> None:
        if self.updated:
            return
        if self.theta == "auto":
            self.account = Account(1, 0.0, 0.0)
        elif self.robust_form == "posterior":
            self.account = self.judged(self._settled().P, self.now)

    @property
    def total(self) -> Account:
        """All steps, the present one included once its theta was used."""
        return self.past_account if self.account is None else self.past_account + self.account

    def worst_case(self, steps: int, delay: int) -> WorstCase:
        """The worst disturbance of the coming steps, whose measurements all come `delay` steps late."""
        start = self._closed(self._settled()).P
        F, H, Q, R = self.F.value, self.H.value, self.Q.value, self.R.value
        model, L = augmented_model(Model(F, H, Q, R), self.channel.max_delay), self.root()
        H, P = at_block(H, delay, model.dim_x), start
        gains, thetas = [], []
        for step in range(self.now + 1, self.now + steps + 1):
            P = model.F @ P @ model.F.T + model.Q
            judged = P if self.robust_form == "prior" else robust_gain(P, H, R, L, 0.0).P
            thetas.append(self.judged(judged, step).lowest)
            K, P, *_ = robust_gain(P, H, R, L, thetas[-1], self.robust_form)
            gains.append(K)
        error: Form = "prior" if self.robust_form == "prior" else "posterior"
        return worst_case_gain(gains, model.F, H, model.Q, R, start, S=L.T @ L, theta=thetas, form=error)


def checked_theta(value: object, name: str = "theta") -> float:
    """A finite number that is not negative."""
    theta = number(value, name)
    if not 0.0 <= theta < np.inf:
        raise UfirextError(f"{name} must be a finite number, not negative, got {value!r}")
    return theta
