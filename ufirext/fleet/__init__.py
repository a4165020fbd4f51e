"""Many tracks in lock step: one product a tick for all of them."""

from .fleet import Fleet as Fleet

__all__ = ["Fleet"]
