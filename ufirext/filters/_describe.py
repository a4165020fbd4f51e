"""A repr worth reading, in every state of a filter."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from ._surface import FilterSurface

_NAMES = (
    "x",
    "P",
    "x_prior",
    "P_prior",
    "x_post",
    "P_post",
    "F",
    "Q",
    "R",
    "H",
    "K",
    "y",
    "S",
    "SI",
    "M",
    "B",
    "z",
)
_FIGURES = ("log_likelihood", "likelihood", "mahalanobis", "alpha")


def describe(filter_: FilterSurface, extra: tuple[str, ...] = ()) -> str:
    """One name a line, arrays aligned below each other, as filterpy prints its filters."""
    names = ("dim_x", "dim_z", "dim_u", *extra, *_NAMES, *_FIGURES)
    return "\n".join(
        [f"{type(filter_).__name__} object", *(_line(name, _value(filter_, name)) for name in names)]
    )


def _value(filter_: FilterSurface, name: str) -> Any:
    try:
        return getattr(filter_, name)
    except (ValueError, np.linalg.LinAlgError) as error:
        return f"<{error}>"


def _line(name: str, value: Any) -> str:
    if not isinstance(value, np.ndarray):
        return f"{name} = {value}"
    if value.ndim == 2 and value.shape[1] == 1 and len(value) > 1:
        return f"{name} = {np.array2string(value.T, precision=6)}.T"
    text = np.array2string(value, precision=6)
    return f"{name} = " + text.replace("\n", "\n" + " " * (len(name) + 3))
