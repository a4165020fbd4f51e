"""What is to be filtered, checked and in one form."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._arrays import Array
from ..model import Model
from .arguments import Prior

__all__ = ["PerStep", "Request"]


@dataclass(frozen=True)
class PerStep:
    """Matrices that change from step to step, (T, ..) each, None where the model's holds."""

    F: Array | None = None
    Q: Array | None = None
    H: Array | None = None
    R: Array | None = None

    @property
    def empty(self) -> bool:
        """Whether the model's matrices hold throughout."""
        return all(a is None for a in (self.F, self.Q, self.H, self.R))

    def copy(self) -> PerStep:
        """The same in arrays of its own."""
        return PerStep(*(None if a is None else a.copy() for a in (self.F, self.Q, self.H, self.R)))


@dataclass(frozen=True)
class Request:
    """Series z (S, T, dim_z) of a model, and how they are filtered; `noise` is in the model already."""

    model: Model
    z: Array
    horizon: int
    lag: int
    unbiased: bool
    missing: str
    by_arrival: bool
    us: Array | None
    delays: NDArray[np.int64] | None
    prior: Prior | None
    per_step: PerStep

    @property
    def count(self) -> int:
        """Number of series."""
        return len(self.z)

    @property
    def steps(self) -> int:
        """Number of steps."""
        return int(self.z.shape[1])

    def kept(self, holes: bool) -> Request:
        """What covariances ask for, in arrays of its own: the caller may use his for something else by then.

        Of z that is which components are missing, if any may be (`holes`).
        """
        z: Any = np.broadcast_to(np.float16(0.0), self.z.shape)
        if holes:
            z = np.where(np.isnan(self.z), np.float16(np.nan), z)
        return replace(self, z=z, per_step=self.per_step.copy())

    def only(self, chosen: Any) -> Request:
        """The request for some of the series: an index array or a slice."""
        prior = self.prior
        return replace(
            self,
            z=self.z[chosen],
            us=None if self.us is None else self.us[chosen],
            delays=None if self.delays is None else self.delays[chosen],
            prior=None if prior is None else Prior(prior.x[chosen], prior.P[chosen]),
        )
