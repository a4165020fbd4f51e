"""What the filters with a finite memory add to filterpy's face."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from ..errors import UfirextError
from ..model import Model
from ._hot import HotFilter

if TYPE_CHECKING:
    from ..channels import Channel


class Windowed(Protocol):
    """What a window says of itself."""

    @property
    def ready(self) -> bool:
        """Whether the rows within reach determine the state."""

    dropped: int
    solution: Any


class WindowFilter(HotFilter):
    """A filter that remembers a window of measurements."""

    @property
    def channel(self) -> Channel | None:
        """What the network does to measurements, None where nothing was said."""
        return getattr(self._state, "channel", None)

    @property
    def max_delay(self) -> int | None:
        """The oldest measurement that can come, in steps; None without a channel."""
        return None if self.channel is None else self.channel.max_delay

    def _model_to_certify(self) -> Model:
        """The model, where the gain of a full window is one and the same at every step."""
        channel = self.channel
        if channel is not None and not channel.stamped and channel.max_delay:
            raise UfirextError(
                f"a gain to certify must be the same at every step, behind {channel} each row is another; "
                "certify a filter without a channel, or with time stamps"
            )
        self._state.settle()
        return self._state.model()

    @property
    def ready(self) -> bool:
        """True once the rows in the window determine the state."""
        state: Windowed = self._state  # type: ignore[assignment]
        return state.ready

    @property
    def rows(self) -> int:
        """Number of measurements in the window; for minimum variance, of steps that have any."""
        state: Windowed = self._state.look()  # type: ignore[assignment]
        return 0 if state.solution is None else int(state.solution.rows)

    @property
    def dropped(self) -> int:
        """Number of measurements left out: too late to join the window, or duplicates."""
        state: Windowed = self._state  # type: ignore[assignment]
        return state.dropped
