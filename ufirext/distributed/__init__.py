"""Series that outgrow a processor or a memory: on Dask, on xarray, and from file to file."""

from .files import filter_file
from .lazy import LazyEstimate, filter_series
from .named import filter_dataarray
from .part import BeyondOverlap, BeyondOverlapWarning, chunk_length

__all__ = [
    "BeyondOverlap",
    "BeyondOverlapWarning",
    "LazyEstimate",
    "chunk_length",
    "filter_dataarray",
    "filter_file",
    "filter_series",
]
