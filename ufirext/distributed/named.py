"""Series with named dimensions: xarray around NumPy and Dask."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import UfirextError
from ..model import Model
from ..series import filter_series as filter_whole
from .lazy import filter_series

__all__ = ["filter_dataarray"]


def filter_dataarray(
    model: Model,
    zs: Any,
    horizon: int | str,
    *,
    time: str = "time",
    component: str | None = None,
    state: str = "state",
    **options: Any,
) -> Any:
    """`filter_series` on an xarray DataArray through ``apply_ufunc``: names kept, lazily where it is lazy.

    Parameters
    ----------
    model, horizon
        As in `ufirext.filter_series`.
    zs : xarray.DataArray
        With the dimension `time` and, unless dim_z is 1, `component`; every further one is a series of its
        own.
    time, component, state : str, optional
        Names of dimensions; `state` is the new one.
    **options
        Keywords of `filter_series`, such as lag, missing, chunks, overlap; for a DataArray in memory those of
        `ufirext.filter_series`.

    Returns
    -------
    xarray.DataArray
        The other dimensions, then `time` and `state`; NaN where a row is not ready.

    Raises
    ------
    ImportError
        Without xarray.
    UfirextError, ShapeError
        If zs is no DataArray, or lacks a dimension that is named.

    Examples
    --------
    >>> import numpy as np, xarray as xr
    >>> from ufirext import kinematic
    >>> from ufirext.distributed import filter_dataarray
    >>> zs = xr.DataArray(np.zeros((3, 500)), dims=("ship", "time"))
    >>> filter_dataarray(kinematic(1, 1, 0.1), zs, horizon=50).sizes
    Frozen({'ship': 3, 'time': 500, 'state': 2})
    """
    try:
        import xarray
    except ImportError as error:
        raise ImportError(
            f"named dimensions need {error.name}: pip install 'ufirext[distributed]'"
        ) from error
    if not isinstance(zs, xarray.DataArray):
        raise UfirextError(f"zs must be an xarray.DataArray, got {type(zs).__name__}")
    added = component is None
    if added and model.dim_z != 1:
        raise UfirextError(f"component must name the dimension of the {model.dim_z} measured components")
    own = (time,) if component is None else (time, component)
    absent = [name for name in own if name not in zs.dims]
    if absent:
        raise UfirextError(
            f"zs must have the dimension {absent[0]!r}, it has {', '.join(map(repr, zs.dims))}"
        )

    def filtered(values: Any) -> Any:
        values = values[..., None] if added else values
        lead = values.shape[:-2]
        flat = values.reshape((-1, *values.shape[-2:]))
        if isinstance(flat, np.ndarray):
            x = filter_whole(model, flat, horizon, **options).x
        else:
            x = filter_series(model, flat, horizon, **options).x
        return x.reshape((*lead, *x.shape[-2:]))

    return xarray.apply_ufunc(
        filtered,
        zs,
        input_core_dims=[list(own)],
        output_core_dims=[[time, state]],
        dask="allowed",
        keep_attrs=True,
    )
