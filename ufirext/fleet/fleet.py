"""Fleet: many targets of one model, filtered in lock step."""

from __future__ import annotations

from os import PathLike
from typing import Any

import numpy as np

from .._array_api import Space, is_native
from .._arrays import Array, dimension, one_of, rectangular, require_counts
from ..errors import HorizonError, ShapeError, UfirextError
from ..horizon import best_horizon, check_horizon
from ..model import Model, require_model
from . import archive
from .engine import Engine

__all__ = ["Fleet"]

MISSING = ("extend", "skip")


class Fleet:
    """Unbiased FIR filters of many tracks in lock step: one product of the gain and the windows a tick.

    Every track is what `UFIRFilter(..., horizon=horizon, missing=missing)` gives it, after a predict() and an
    update(z, delay=...) at every tick; only before a track is ready it is NaN here and not a Kalman filter.

    Parameters
    ----------
    model : Model
        Shared by all tracks.
    horizon : int or "auto"
        Length of the window in ticks; "auto" is ``best_horizon(model)``.
    tracks : int
        Tracks to begin with. They have slots 0 .. tracks - 1; `join` and `leave` change them.
    missing : {"extend", "skip"}
        What a tick without a measurement does, as in `UFIRFilter`. "extend": the track coasts, and later
        reaches back beyond its window while that holds too few instants. "skip": the window loses a row.

    Attributes
    ----------
    model, horizon, missing, reach
        As given, and how many ticks back a row is remembered: 4 horizon + 64 ("extend") or horizon ("skip").
    tracks : int
        Number of slots, the rows of Z and X.
    active : ndarray of bool, (tracks,)
        Slots that hold a track.
    ready : ndarray of bool, (tracks,)
        Tracks whose rows determine the state; the others are NaN in X.
    dropped : ndarray of int, (tracks,)
        Measurements that came too late to join a window.
    ticks : int
        Steps taken.

    Raises
    ------
    HorizonError, UnobservableWindow
        For a horizon that is no positive integer, or one that can never determine the state.
    ShapeError
        For a number of tracks that is none.
    UfirextError
        For a word that `missing` does not know.

    Notes
    -----
    The measurements lie in a time-major ring of `horizon` slots (more once a track has gaps), where NaN marks
    what is not a plain row. The product X = W G of all windows with the constant gain is NaN exactly for the
    tracks with holes or late rows, and for those that are too young; these few are solved by masked normal
    equations, vectorised over the tracks, or, where hardly any rows are left, by an exact gain for each
    pattern of rows. A track coasts as long as the oldest row of its last estimate is within `reach`.

    The first measurements decide the library (NumPy, torch, JAX, CuPy), the device and the dtype.

    Examples
    --------
    >>> import numpy as np
    >>> from ufirext import Fleet, kinematic
    >>> fleet = Fleet(kinematic(1, 1, 1.0), horizon=4, tracks=3)
    >>> for n in range(6):
    ...     X = fleet.step([[1.0 * n], [-2.0 * n], [np.nan if n < 5 else 0.0]])
    >>> X.round(9)
    array([[  5.,   1.],
           [-10.,  -2.],
           [ nan,  nan]])
    >>> fleet.ready
    array([ True,  True, False])
    """

    def __init__(
        self, model: Model, horizon: int | str = "auto", tracks: int = 1, *, missing: str = "extend"
    ) -> None:
        require_model(model)
        one_of(missing, MISSING, "missing")
        if isinstance(horizon, str):
            if horizon != "auto":
                raise HorizonError(f'horizon must be an integer or "auto", got {horizon!r}')
            horizon = best_horizon(model)
        self.model, self.missing = model, missing
        self.horizon = check_horizon(horizon, model)
        tracks = dimension(tracks, "tracks", 0, "slots")
        self._engine = Engine(model, self.horizon, tracks, extends=missing == "extend")

    # -- one tick --------------------------------------------------------------------------------------------

    def step(self, Z: Any, delay: Any = None) -> Any:
        """One tick for all tracks: predict, take the measurements, estimate.

        Parameters
        ----------
        Z : array_like, (tracks, dim_z), or (tracks,) where dim_z is 1
            NaN: this component did not come. Slots without a track must be NaN.
        delay : int or array_like of int, (tracks,), optional
            Ages of the measurements in ticks: row s was taken delay[s] ticks ago.

        Returns
        -------
        array, (tracks, dim_x)
            The estimates after this tick, NaN where a track is not ready; library, device and dtype of the
            first Z. It is the caller's own.

        Raises
        ------
        ShapeError, NonFiniteError, HorizonError
            For wrong shapes, infinite measurements, a delay that is no count.
        UfirextError
            For a measurement in a slot without a track, or arrays of another library than before.
        """
        engine = self._engine
        space = engine.space or Space.of(Z, "Z")
        z = space.array(Z, "Z")
        wanted = (engine.tracks, self.model.dim_z)
        if z.shape == wanted[:1] and wanted[1] == 1:
            z = space.xp.reshape(z, wanted)
        if tuple(z.shape) != wanted:
            raise ShapeError(f"Z must have shape {wanted} (tracks, dim_z), got {tuple(z.shape)}")
        return engine.step(space, z, self._delays(space, delay))

    def _delays(self, space: Space, delay: Any) -> np.ndarray[Any, Any] | None:
        if delay is None:
            return None
        ages = rectangular(delay, "delay") if is_native(delay) else space.host(delay)
        if ages.dtype.kind not in "iu" or ages.shape not in ((), (self.tracks,)):
            raise HorizonError(
                f"delay must be an integer or ({self.tracks},) integers, one a track, got {ages.dtype} "
                f"of shape {ages.shape}"
            )
        require_counts(ages, "delay")
        return np.broadcast_to(ages, (self.tracks,)).astype(np.int64) if ages.any() else None

    # -- tracks ----------------------------------------------------------------------------------------------

    def join(self, count: int = 1) -> np.ndarray[Any, np.dtype[np.int64]]:
        """Begin `count` new tracks.

        Returns
        -------
        ndarray of int, (count,)
            Their slots: free ones first, lowest first, then new ones at the end (`tracks` grows, which copies
            the fleet once). A track keeps its slot until it leaves.
        """
        return self._engine.join(dimension(count, "count", 0, "new tracks"))

    def leave(self, slots: Any) -> None:
        """End the tracks in these slots (an int or integers); what they measured is forgotten.

        Raises
        ------
        UfirextError
            If a slot holds no track.
        """
        self._engine.leave(self._slots(slots))

    def _slots(self, slots: Any) -> np.ndarray[Any, Any]:
        found = np.atleast_1d(rectangular(slots, "slots"))
        if found.size == 0:
            return np.zeros(0, np.int64)
        if found.dtype.kind not in "iu" or found.ndim != 1:
            raise ShapeError(f"slots must be integers, got {found.dtype} of shape {found.shape}")
        outside = found[(found < 0) | (found >= self.tracks)]
        if outside.size:
            raise UfirextError(f"slots must lie in 0 .. {self.tracks - 1}, got {outside[0]}")
        empty = found[~self._engine.active[found]]
        if empty.size:
            raise UfirextError(f"slot {empty[0]} holds no track: join() begins one")
        return found.astype(np.int64)

    # -- what is known ---------------------------------------------------------------------------------------

    @property
    def tracks(self) -> int:
        """Number of slots."""
        return self._engine.tracks

    @property
    def ticks(self) -> int:
        """Steps taken."""
        return self._engine.now + 1

    @property
    def reach(self) -> int:
        """Ticks after which a row is forgotten for good."""
        return self._engine.limits.reach

    @property
    def active(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Slots that hold a track, (tracks,)."""
        return self._engine.active.copy()

    @property
    def ready(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """Tracks whose rows determine the state, (tracks,)."""
        return self._engine.ready.copy()

    @property
    def dropped(self) -> np.ndarray[Any, np.dtype[np.int64]]:
        """Measurements that came too late to join a window, (tracks,)."""
        return self._engine.dropped.copy()

    @property
    def x(self) -> Any:
        """The last estimates again, (tracks, dim_x)."""
        return self._engine.estimates()

    @property
    def nbytes(self) -> int:
        """Bytes that the fleet's measurements and estimates take."""
        return self._engine.nbytes

    def covariance(self, slots: Any = None) -> Array:
        """Exact error covariances under the model's Q and R, computed now.

        Tracks with a full window share one; every other pattern of holes and delays costs a design of its
        own (about a millisecond).

        Parameters
        ----------
        slots : int or array_like of int, optional
            Default: all slots.

        Returns
        -------
        ndarray, (len(slots), dim_x, dim_x)
            NaN where a track is not ready.
        """
        if slots is None:
            return self._engine.covariance(np.arange(self.tracks))
        return self._engine.covariance(self._slots(slots))

    # -- files -----------------------------------------------------------------------------------------------

    def save(self, path: str | PathLike[str]) -> None:
        """Write the whole state to an npz file, to the bit. An older file is replaced only once it is whole.

        Parameters
        ----------
        path : path-like
        """
        archive.save(self, path)

    @classmethod
    def load(cls, path: str | PathLike[str], like: Any = None) -> Fleet:
        """A fleet that goes on where `save` was called.

        Parameters
        ----------
        path : path-like
        like : array, optional
            Of the library and on the device to compute with; default NumPy.

        Raises
        ------
        UfirextError
            If the file is damaged, or no fleet of this version's format.
        """
        return archive.load(cls, path, like)

    def __repr__(self) -> str:
        return (
            f"Fleet({self.model!r}, horizon={self.horizon}, tracks={self.tracks}, missing={self.missing!r}; "
            f"ticks={self.ticks}, active={int(self._engine.active.sum())}, "
            f"ready={int(self._engine.ready.sum())})"
        )
