"""Recorded series through a filter, in filterpy's shapes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence, Sized
from itertools import islice, repeat
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from .._arrays import Array, finite, matrix, real, shown
from ..errors import ShapeError

if TYPE_CHECKING:
    from ._surface import FilterSurface

PerStep = Iterable[ArrayLike | None] | None
NAMES = ("Fs", "Qs", "Hs", "Rs", "Bs", "us")
# Series from so many steps on may be worked out at once.
LONG = 2000


def run_series(
    f: FilterSurface, zs: Any, per_step: Sequence[PerStep], update_first: bool, saver: Any
) -> tuple[Array, Array, Array, Array]:
    """Means and covariances after update and after predict; `per_step` holds Fs, Qs, Hs, Rs, Bs, us."""
    if not isinstance(zs, Sized) or (isinstance(zs, np.ndarray) and not zs.ndim):
        raise ShapeError(f"zs must be a sequence with a measurement for each step, got {shown(zs)}")
    per_step = [
        None if values is None else _entries(values, name, len(zs))
        for values, name in zip(per_step, NAMES, strict=True)
    ]
    if not update_first and saver is None and len(zs) >= LONG:
        from ..series.hook import whole_series  # a long series is worth the import

        found = whole_series(f, zs, per_step, lambda part: _stream(f, part, per_step, False, None))
        if found is not None:
            return found
    return _stream(f, zs, per_step, update_first, saver)


def _entries(values: Any, name: str, count: int) -> Any:
    """A list of one entry a step, at least; ShapeError where it ends before the series does."""
    if not isinstance(values, Iterable) or (isinstance(values, np.ndarray) and not values.ndim):
        raise ShapeError(f"{name} must be a sequence with an entry for each step, got {shown(values)}")
    if not isinstance(values, Sized):
        values = list(islice(values, count))
    if len(values) < count:
        raise ShapeError(
            f"{name} must hold one entry for each of the {count} steps of the series "
            f"(None for the filter's own), got {len(values)}"
        )
    return values


def _stream(
    f: FilterSurface, zs: Any, per_step: Sequence[PerStep], update_first: bool, saver: Any
) -> tuple[Array, Array, Array, Array]:
    """Step by step."""
    count, form = len(zs), (f.dim_x, 1) if f._state.form == 2 else (f.dim_x,)
    means, means_p = np.zeros((count, *form)), np.zeros((count, *form))
    covs, covs_p = (np.zeros((count, f.dim_x, f.dim_x)) for _ in range(2))
    lists = [repeat(None) if values is None else values for values in per_step]
    for i, (z, F, Q, H, R, B, u) in enumerate(zip(zs, *lists, strict=False)):
        for verb in ("update", "predict") if update_first else ("predict", "update"):
            if verb == "update":
                f.update(z, R=R, H=H)
                means[i], covs[i] = f.x, f._state.look().P.value
            else:
                f.predict(u=u, B=B, F=F, Q=Q)
                means_p[i], covs_p[i] = f.x, f._state.look().P.value
        if saver is not None:
            saver.save()
    return means, covs, means_p, covs_p


def smooth_series(
    Xs: ArrayLike, Ps: ArrayLike, Fs: Iterable[ArrayLike], Qs: Iterable[ArrayLike], inv: Any
) -> tuple[Array, Array, Array, Array]:
    """Rauch-Tung-Striebel smoothing: smoothed means and covariances, smoother gains, predicted
    covariances.
    """
    x, P = finite(real(Xs, "Xs"), "Xs"), finite(real(Ps, "Ps"), "Ps")
    count, n = P.shape[:2] if P.ndim == 3 else (0, 0)
    if x.shape not in ((count, n), (count, n, 1)) or P.shape != (count, n, n):
        raise ShapeError(
            "Xs and Ps must have the same length and the shapes that batch_filter gives them, (T, dim_x) or "
            f"(T, dim_x, 1) and (T, dim_x, dim_x), got {x.shape} and {P.shape}"
        )
    transitions, noises = _entries(Fs, "Fs", count), _entries(Qs, "Qs", count)
    Pp, K = P.copy(), np.zeros((count, n, n))
    for k in range(count - 2, -1, -1):
        F = matrix(transitions[k + 1], (n, n), f"Fs[{k + 1}]")
        Q = matrix(noises[k + 1], (n, n), f"Qs[{k + 1}]")
        Pp[k] = F @ P[k] @ F.T + Q
        try:
            K[k] = P[k] @ F.T @ inv(Pp[k])
        except np.linalg.LinAlgError:
            K[k] = P[k] @ F.T @ np.linalg.pinv(Pp[k])
        x[k] += K[k] @ (x[k + 1] - F @ x[k])
        P[k] += K[k] @ (P[k + 1] - Pp[k]) @ K[k].T
    return x, P, K, Pp
