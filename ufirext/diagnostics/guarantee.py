"""What an H-infinity filter promises, in words."""

from __future__ import annotations

from dataclasses import dataclass

from ..recursions.hinfinity import Form

__all__ = ["Guarantee"]

_ERROR = {"posterior": "x_n - x^_n (after the update)", "prior": "x_n - F x^_{n-1} (before the update)"}


@dataclass(frozen=True, repr=False)
class Guarantee:
    """Which error is bounded, by what, for which disturbances.

    Attributes
    ----------
    form : {"posterior", "prior", "mixed"}
        Of the filter; "mixed" guarantees nothing.
    steps : int
        Steps counted so far.
    theta : tuple of float
        Smallest and largest theta in use.
    theta_max : float
        The smallest limit met, below which theta stayed.
    clipped : int
        Steps at which theta was lowered to stay below its limit.
    max_delay : int
        The oldest measurement taken in; the bound is for the true noises, not for an effective one.
    averaged : bool
        The delays were unknown: what averaging over them adds counts as measurement noise v.

    Examples
    --------
    >>> from ufirext.diagnostics import Guarantee
    >>> print(Guarantee("posterior", steps=20, theta=(0.01, 0.01), theta_max=0.04))
    H-infinity, a-posteriori form, 20 steps: the error e_n = x_n - x^_n (after the update) keeps
      sum theta_n |e_n|^2_S <= |x_0 - x^_0|^2_{P0^-1} + sum |w_n|^2_{Q^-1} + sum |v_n|^2_{R^-1}
    for every disturbance x_0, w, v, random or not; theta = 0.01, smallest limit 0.04
    """

    form: Form
    steps: int
    theta: tuple[float, float]
    theta_max: float
    clipped: int = 0
    max_delay: int = 0
    averaged: bool = False

    @property
    def holds(self) -> bool:
        """There is a bound: the filter is one of the two that have one."""
        return self.form in _ERROR

    def __str__(self) -> str:
        if not self.holds:
            return (
                f"no guarantee, {self.steps} steps: the gain of the a-priori filter under the condition of "
                "the a-posteriori filter bounds neither error"
            )
        low, high = self.theta
        used = f"{low:.4g}" if low == high else f"{low:.4g} .. {high:.4g}"
        extra = f", lowered at {self.clipped} steps" if self.clipped else ""
        late = f", delays up to {self.max_delay} steps included" if self.max_delay else ""
        name = "a-posteriori" if self.form == "posterior" else "a-priori"
        if self.averaged:
            late = ", what the unknown delay adds counted in v"
        return (
            f"H-infinity, {name} form, {self.steps} steps: the error e_n = {_ERROR[self.form]} keeps\n"
            "  sum theta_n |e_n|^2_S <= |x_0 - x^_0|^2_{P0^-1} + sum |w_n|^2_{Q^-1} + sum |v_n|^2_{R^-1}\n"
            f"for every disturbance x_0, w, v, random or not{late}; theta = {used}, "
            f"smallest limit {self.theta_max:.4g}{extra}"
        )

    __repr__ = __str__
