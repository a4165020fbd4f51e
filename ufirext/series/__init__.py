"""Whole series at once: finite memory makes filtering parallel in time, exactly."""

from .estimate import SeriesEstimate
from .plan import SeriesPlan, series_plan
from .series import filter_series

__all__ = ["SeriesEstimate", "SeriesPlan", "filter_series", "series_plan"]
