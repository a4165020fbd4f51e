"""The order of the gallery: from the first steps to what few need."""

from __future__ import annotations

FIRST = (
    "drop_in",
    "sort_tracking",
    "gps_drive",
    "choosing_the_horizon",
    "lag_and_error",
    "which_filter",
    "worst_disturbance",
    "certificate",
    "control_dead_time",
    "fleet_of_tracks",
    "long_series_on_dask",
)


class Order:
    """Sort key of sphinx-gallery: scripts named above in that order, then the others by name."""

    def __init__(self, src_dir: str) -> None:
        """Take the folder, which makes no difference."""

    def __call__(self, filename: str) -> tuple[int, str]:
        """The place of a script."""
        name = filename.removesuffix(".py")
        return (FIRST.index(name) if name in FIRST else len(FIRST), name)
