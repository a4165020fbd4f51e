"""Long series on Dask: parts with overlap, worked out when asked for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from .._arrays import integer, real, unmasked, without_mask
from ..errors import ShapeError, UfirextError
from ..model import Model
from .part import Task, checked, chunk_length

__all__ = ["LazyEstimate", "filter_series"]


@dataclass(frozen=True)
class LazyEstimate:
    """Estimates that are worked out when computed.

    Attributes
    ----------
    x : dask.array.Array, (T, dim_x) or (S, T, dim_x)
        NaN where a row is not ready.
    ready : dask.array.Array of bool, (T,) or (S, T)
    horizon, lag, overlap : int
        Length of the window, lag of the estimates, rows each part is preceded by.
    aligned : bool
        Whether all parts begin and end where a part of the whole series' plan does and hold all series:
        those without holes then have the bits of `ufirext.filter_series`, else its numbers to 1e-12.

    Examples
    --------
    >>> import numpy as np
    >>> from ufirext import kinematic
    >>> from ufirext.distributed import filter_series
    >>> estimate = filter_series(kinematic(1, 1, 1.0), np.arange(5000.0), horizon=20, lag=3, chunks=1000)
    >>> type(estimate).__name__, estimate.overlap, estimate.x.numblocks
    ('LazyEstimate', 22, (5, 1))
    """

    x: Any
    ready: Any
    horizon: int
    lag: int
    overlap: int
    aligned: bool


def filter_series(
    model: Model,
    zs: Any,
    horizon: int | str,
    *,
    lag: int = 0,
    us: Any = None,
    delays: Any = None,
    missing: str = "extend",
    noise: tuple[Any, Any] | None = None,
    window: str = "arrivals",
    longest_delay: int | None = None,
    chunks: int | None = None,
    overlap: int | None = None,
    beyond: str = "raise",
) -> LazyEstimate:
    """`ufirext.filter_series` on Dask: the parts of a series are filtered apart, and exactly.

    Parameters
    ----------
    model, horizon, lag, missing, noise, window
        As in `ufirext.filter_series`; missing="predict" remembers everything and is refused.
    zs : dask.array.Array or array_like, (T, dim_z) or (S, T, dim_z)
        Measurements; (T,) where dim_z is 1. A memory-mapped array is read part by part.
    us : dask.array.Array or array_like, (T, dim_u) or (S, T, dim_u), optional
    delays : dask.array.Array or array_like of int, (T,) or (S, T), optional
        As in `ufirext.filter_series`.
    longest_delay : int, optional
        The largest of the delays; needed where these are a Dask array.
    chunks : int, optional
        Rows of a part. Default: the chunks of a Dask array, unless shorter than the overlap; else
        `chunk_length`.
    overlap : int, optional
        Rows of the past each part sees; default horizon - 1 + lag + longest_delay.
    beyond : {"raise", "warn"}
        What is done where rows are missing and an estimate depends on what lies before the overlap. The
        message says which overlap is always enough.

    Returns
    -------
    LazyEstimate

    Raises
    ------
    ImportError
        Without Dask.
    BeyondOverlap
        When computed, see `beyond`.

    Examples
    --------
    >>> import numpy as np
    >>> from ufirext import kinematic
    >>> from ufirext.distributed import filter_series
    >>> path = 0.5 * np.arange(40_000.0)
    >>> estimate = filter_series(kinematic(1, 1, 0.1), path, horizon=50, chunks=10_000)
    >>> estimate.x
    dask.array<..., shape=(40000, 2), dtype=float64, chunksize=(10000, 2), chunktype=numpy.ndarray>
    >>> estimate.x[-1].compute().round(6)
    array([1.99995e+04, 5.00000e+00])
    """
    da = _dask()
    series = _as_lazy(da, zs, model)
    many = series.ndim == 3
    if delays is not None and longest_delay is None:
        if isinstance(delays, da.Array):
            raise UfirextError("longest_delay must be given with delays that are a Dask array")
        longest_delay = int(np.max(delays, initial=0))
    task = checked(
        model,
        horizon,
        overlap,
        lag=lag,
        missing=missing,
        noise=noise,
        window=window,
        longest_delay=longest_delay or 0,
        beyond=beyond,
    )
    series = _cut(series if many else series[None], task, chunks, isinstance(zs, da.Array))
    extra = [
        None if a is None else _alongside(da, a, name, series, many)
        for name, a in (("delays", delays), ("us", us))
    ]
    x = _mapped(da, task, series, extra)
    x = x if many else x[0]
    (*inner, _), alignment = series.chunks[1] or (0,), task.plan.alignment
    # Series are filtered in groups, which parts of the first axis would cut elsewhere.
    aligned = len(series.chunks[0]) < 2 and all(length % alignment == 0 for length in inner)
    return LazyEstimate(x, ~da.isnan(x).any(axis=-1), task.horizon, task.lag, task.overlap, aligned)


def _dask() -> Any:
    try:
        import dask.array
    except ImportError as error:
        raise ImportError(f"series on Dask need {error.name}: pip install 'ufirext[distributed]'") from error
    return dask.array


def _as_lazy(da: Any, zs: Any, model: Model) -> Any:
    array = zs if isinstance(zs, da.Array) else unmasked(zs)[0]
    if not isinstance(array, da.Array | np.ndarray):
        array = real(array, "zs")
    if array.dtype.kind in "cmMSTU":
        raise ShapeError(f"zs must be an array of real numbers, got {array.dtype}")
    if array.ndim == 1 and model.dim_z == 1:
        array = array[:, None]
    if array.ndim not in (2, 3) or array.shape[-1] != model.dim_z:
        raise ShapeError(
            f"zs must have shape (T, {model.dim_z}) or (S, T, {model.dim_z}), got {tuple(zs.shape)}"
        )
    return array if isinstance(array, da.Array) else da.from_array(array, chunks=-1, name=False)


def _cut(series: Any, task: Task, chunks: int | None, lazy: bool) -> Any:
    """(S, T, dim_z) in parts along time; none is shorter than the overlap, which Dask asks for."""
    if chunks is not None:
        least = max(task.overlap, 1)
        length = integer(chunks, "chunks", least, advice="parts must not be shorter than the overlap")
    else:
        length = chunk_length(task.model, task.horizon, lag=task.lag, overlap=task.overlap)
    lengths = series.chunks[1]
    if not (lazy and chunks is None and min(lengths[:-1], default=task.overlap) >= task.overlap):
        whole, rest = divmod(series.shape[1], length)
        lengths = (length,) * whole + ((rest,) if rest or not whole else ())
    if len(lengths) > 1 and lengths[-1] < task.overlap:
        lengths = (*lengths[:-2], lengths[-2] + lengths[-1])
    # Many short series: so many in a part that it has rows enough.
    together = series.chunks[0] if lazy else max(1, length // max(series.shape[1], 1))
    return series.rechunk({0: together, 1: lengths, 2: -1})


def _alongside(da: Any, values: Any, name: str, series: Any, many: bool) -> Any:
    """Delays (S, T) or inputs (S, T, dim_u) in the same parts as the series."""
    if isinstance(values, da.Array):  # what follows may drop a mask
        array = da.map_blocks(partial(without_mask, name=name), values, dtype=values.dtype)
    else:
        array = da.asarray(np.asarray(without_mask(values, name)))
    lead = series.shape[:2]
    if array.shape[:1] == lead[1:] and array.shape[:2] != lead:
        array = da.broadcast_to(array, (lead[0], *array.shape))
    if array.shape[:2] != lead or array.ndim > 3:
        wanted = lead if many else lead[1:]
        raise ShapeError(f"{name} must begin with the axes {wanted} of zs, got {tuple(array.shape)}")
    return array.rechunk({0: series.chunks[0], 1: series.chunks[1], **({2: -1} if array.ndim == 3 else {})})


def _mapped(da: Any, task: Task, series: Any, extra: list[Any]) -> Any:
    """map_overlap of the task: every part sees `overlap` rows of the part before."""
    depth = min(task.overlap, series.shape[1])
    delays, us = extra
    arrays = [series, *(a for a in extra if a is not None)]
    names = ["z", *(name for name, a in (("delays", delays), ("us", us)) if a is not None)]
    # Delays have no last axis; map_overlap wants the same axes of all.
    arrays = [a if a.ndim == 3 else a[..., None] for a in arrays]
    return da.map_overlap(
        _part,
        *arrays,
        depth={0: 0, 1: (depth, 0), 2: 0},
        boundary="none",
        trim=False,
        align_arrays=False,
        allow_rechunk=False,
        dtype=float,
        meta=np.empty((0, 0, 0)),
        chunks=(series.chunks[0], series.chunks[1], (task.model.dim_x,)),
        names=tuple(names),
        task=task,
        depth_of_parts=depth,
        starts=tuple(np.concatenate([[0], np.cumsum(series.chunks[1])[:-1]]).tolist()),
    )


def _part(
    *arrays: Any, names: Any, task: Task, depth_of_parts: int, starts: Any, block_info: Any = None
) -> Any:
    """One block: drop the overlap; the first block has none."""
    given = dict(zip(names, arrays, strict=True))
    number = block_info[None]["chunk-location"][1]
    before = depth_of_parts if number else 0
    delays = given.get("delays")
    return task.run(
        np.asarray(unmasked(given["z"])[0]),
        starts[number],
        before,
        None if delays is None else np.asarray(delays)[..., 0],
        given.get("us"),
    )
