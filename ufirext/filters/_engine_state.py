"""What state objects with an engine share: the warm-up before the rows suffice, and copies."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable
from typing import Any, Self

from .._arrays import Array
from ..engines.covariance import Covariance
from ._state import POSTED, PREDICTED, SLOW, TURNED, WATCHED, FilterState
from ._update import innovation_gain, joseph


class EngineState(FilterState):
    """A state whose rows are held by an engine, made for the model matrices in `anchor`."""

    engine: Any
    anchor: tuple[Array, ...]

    def __init__(self, dim_x: int, dim_z: int) -> None:
        super().__init__(dim_x, dim_z)
        self.intake: Callable[[Any], bool] | None = None  # z into a ring

    def _anchored(self) -> bool:
        """Whether the model still is the one that the engine was made for."""
        return all(old is getattr(self, name).value for name, old in zip("FHQR", self.anchor, strict=False))

    # -- model matrices that the client holds ----------------------------------------------------------------

    def watch(self) -> None:
        """From here on somebody may hold a model matrix, and edit it; a constant model's hot path goes on."""
        if self.mode == SLOW or self.mode >= TURNED:
            super().watch()
            return
        self._watch_all()
        if self.mode == POSTED:
            self.mode = WATCHED

    def _watch_all(self) -> None:
        super()._watch_all()
        self._choose_put()

    def _choose_put(self) -> None:
        """z goes straight into the ring while x can wait and nothing is watched."""
        self.put = None if self.watching or self.read is None else self.intake

    def drive(self, u: Any, B: Any, x: Array | None = None) -> bool:
        """predict(u) while the model is constant: as in filterpy, inputs go nowhere where there is no B."""
        return x is None and self.mode != PREDICTED and self.B is None and B is None and self._intact()

    def _kalman(self, z: Array, H: Array, R: Array, cross: Array | None) -> Covariance:
        """The book's update, for as long as the rows do not determine the state."""
        P = self.P.value
        cross = None if cross is None or len(z) != cross.shape[1] else cross
        K, S = innovation_gain(P, H, R, cross)
        posterior = joseph(P, K, H, R) if cross is None else P - K @ S @ K.T
        self._publish(self.x + K @ (z - H @ self.x), Covariance.of(posterior))
        return Covariance.of(K)

    def _forked(self, torn: Iterable[str]) -> Self:
        """A settled copy with an engine of its own; `torn` names what must not be shared and is made anew."""
        fork = object.__new__(type(self))
        live = {name: copy.deepcopy(self.__dict__[name]) for name in ("F", "H", "Q", "R", "M", "B")}
        fields = FilterState.__getstate__(self)
        fork.__setstate__(fields | live | dict.fromkeys((*torn, "_x_handed", "_P_handed")))
        fork.watched = ()
        if self.engine is not None:
            fork.engine = self.engine.copy()
            fork.anchor = tuple(
                getattr(fork, name).value if old is getattr(self, name).value else old
                for name, old in zip("FHQR", self.anchor, strict=False)
            )
        return fork
