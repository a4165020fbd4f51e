"""The finite-memory-structure filter-smoother's gain in the convention of its paper."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ._arrays import Array, covariance, finite, integer, matrix, readonly, real, symmetric
from .errors import ShapeError, UfirextError, UnobservableWindow
from .joint import joint_gain, require_definite, square_root
from .model import Model
from .prefixes import start_length
from .window import Window, whitener

__all__ = ["FMSGain", "fms_gain"]


@dataclass(frozen=True, repr=False)
class FMSGain:
    """Gain of the unified filter-smoother: [x^_i; x^_{i-d}] = H Z + L U.

    Attributes
    ----------
    H : ndarray, (2 * n, M * q)
        On Z = [z_{i-M}; ..; z_{i-1}], oldest first: first the rows of x_i, then those of x_{i-d}.
    L : ndarray, (2 * n, M * dim_u)
        On U = [u_{i-M}; ..; u_{i-1}]; no columns without B.
    P : ndarray, (2 * n, 2 * n)
        Joint error covariance; the off-diagonal block is the cross-covariance of the two errors.
    M, d : int
        Length of the window and lag.
    model : Model
        F = A, H = C, Q = G Q G', R, B of the design.

    Examples
    --------
    >>> from ufirext import fms_gain
    >>> fms_gain(A=1, C=1, Q=1, R=1, M=2, d=1)
    FMSGain(M=2, d=1, n=1, q=1): x_i with trace P = 1.66667 and x_{i-1} with trace P = 0.666667
    """

    H: Array
    L: Array
    P: Array
    M: int
    d: int
    model: Model

    def estimate(self, Z: ArrayLike, U: ArrayLike | None = None) -> tuple[Array, Array]:
        """The estimates x^_i and x^_{i-d}, both (n,), from a window's measurements and inputs, oldest first.

        Parameters
        ----------
        Z : array_like, (M, q) or any shape of M * q numbers in that order
        U : array_like, (M, dim_u), required if the gain was designed with B

        Raises
        ------
        ShapeError, NonFiniteError
            For a wrong number of measurements or inputs, NaN or infinity.
        UfirextError
            If U is missing although the model has inputs, or given although it has none.

        Examples
        --------
        >>> from ufirext import fms_gain
        >>> x, lagged = fms_gain(A=1, C=1, Q=1, R=1, M=2, d=1).estimate([1.0, 4.0])
        >>> x, lagged
        (array([3.]), array([3.]))
        """
        if self.model.dim_u and U is None:
            raise UfirextError(
                f"U must hold the {self.M} inputs of the window, because the gain was designed with B, "
                f"got None; pass zeros where there was no input"
            )
        if U is not None and not self.model.dim_u:
            raise UfirextError(
                "U must be None, for the gain was designed without B, got inputs; pass B to fms_gain"
            )
        n, model = self.model.dim_x, self.model
        joint = self.H @ _stacked(Z, (self.M, model.dim_z), "Z")
        if U is not None:
            joint = joint + self.L @ _stacked(U, (self.M, model.dim_u), "U")
        return joint[:n], joint[n:]

    def __repr__(self) -> str:
        n, model = self.model.dim_x, self.model
        inputs = f", dim_u={model.dim_u}" if model.dim_u else ""
        lagged = f" and x_{{i-{self.d}}} with trace P = {np.trace(self.P[n:, n:]):.6g}" if self.d else ""
        return (
            f"FMSGain(M={self.M}, d={self.d}, n={n}, q={model.dim_z}{inputs}): "
            f"x_i with trace P = {np.trace(self.P[:n, :n]):.6g}{lagged}"
        )


def fms_gain(
    A: ArrayLike,
    C: ArrayLike,
    Q: ArrayLike,
    R: ArrayLike,
    M: int,
    d: int,
    B: ArrayLike | None = None,
    G: ArrayLike | None = None,
) -> FMSGain:
    """Gain of Kim's unified FMS filter and smoother, in the letters and the convention of its paper.

    x_{i+1} = A x_i + B u_i + G w_i, z_i = C x_i + v_i; the window holds z_{i-M} .. z_{i-1}, so x^_i is the
    one-step prediction, d = 1 the ordinary filtered estimate of x_{i-1} and d >= 2 a smoother of lag d - 1.
    Solves the paper's problem (12) subject to (11), equation :eq:`fms`. Its solution (14) needs an invertible
    A and Pi and is silently wrong without them; this one needs neither. Inputs enter as in (13).

    Parameters
    ----------
    A : array_like, (n, n)
        May be singular or unstable.
    C : array_like, (q, n)
    Q : array_like, (p, p), or scalar
        Covariance of w, positive semidefinite; p is n without G.
    R : array_like, (q, q), or scalar
        Covariance of v, positive definite.
    M : int
        Number of measurements in the window.
    d : int
        Lag, 0 <= d <= M.
    B : array_like, (n, dim_u), optional
    G : array_like, (n, p), optional
        Default identity.

    Returns
    -------
    FMSGain
        ``.H`` (2n, M q), ``.L`` (2n, M dim_u), ``.P`` (2n, 2n).

    Raises
    ------
    HorizonError
        If M < 1, d < 0 or d > M.
    ShapeError, NonFiniteError, CovarianceError
        For matrices that do not fit, are not finite, or are not covariances.
    UnobservableWindow
        If the window does not determine x_{i-d}; has the rank and the shortest M that works.

    Warns
    -----
    InaccurateGainWarning
        If the model is so nearly unobservable that double precision does not suffice.

    References
    ----------
    Kim (2019), A Unified Finite Memory Structure Filter and Smoother, equations (1)-(14).

    Examples
    --------
    >>> from ufirext import fms_gain
    >>> gain = fms_gain(A=1, C=1, Q=1, R=1, M=2, d=1)
    >>> gain.H.round(4)
    array([[0.3333, 0.6667],
           [0.3333, 0.6667]])
    """
    M = integer(M, "M", 1)
    d = integer(d, "d", 0, M, f"the window [i-{M}, i) holds no state older than x_{{i-{M}}}")
    model, root = _model(A, C, Q, R, B, G)
    window = fms_window(model, M, d)
    if start_length(window, model.dim_x + 1) is None:
        raise _unobservable(model, M, d)
    joint = joint_gain(window, None if model.B is None else [model.B] * M, [root] * M)
    return FMSGain(readonly(joint.K), readonly(joint.L), readonly(joint.P), M, d, model)


def fms_window(model: Model, M: int, d: int) -> Window:
    """The paper's window: M rows, one transition after the newest, x_{i-d} aimed at."""
    W = whitener(model.R)
    return Window([model.F] * M, [model.Q] * M, [model.H] * M, [model.R] * M, range(M), M - d, [W] * M)


def _model(
    A: ArrayLike, C: ArrayLike, Q: ArrayLike, R: ArrayLike, B: ArrayLike | None, G: ArrayLike | None
) -> tuple[Model, Array]:
    """The model, and a square root of G Q G' that has not been through the product."""
    first = np.atleast_2d(real(A, "A"))
    n = len(first)
    transition = matrix(first, (n, n), "A", "(n, n)")
    measured = matrix(np.atleast_2d(real(C, "C")), (None, n), "C", "(q, n)")
    entry = np.eye(n) if G is None else matrix(_columns(G, "G"), (n, None), "G", "(n, p)")
    process = covariance(Q, entry.shape[1], "Q", "(p, p)")
    noise = covariance(R, len(measured), "R", "(q, q)")
    require_definite(noise)
    inputs = None if B is None else matrix(_columns(B, "B"), (n, None), "B", "(n, dim_u)")
    root = entry @ square_root(process)
    return Model(transition, measured, symmetric(entry @ process @ entry.T), noise, inputs), root


def _columns(value: ArrayLike, name: str) -> Array:
    array = real(value, name)
    return array.reshape(-1, 1) if array.ndim < 2 else array


def _stacked(value: ArrayLike, shape: tuple[int, int], name: str) -> Array:
    flat = real(value, name).reshape(-1)
    if flat.size != shape[0] * shape[1]:
        raise ShapeError(f"{name} must hold {shape[0]} rows of {shape[1]}, got {flat.size} numbers")
    return finite(flat, name)


def _unobservable(model: Model, M: int, d: int) -> UnobservableWindow:
    """The error, with the rank of the scaled [C; C A; ..] and the shortest M that works for this d."""
    n = model.dim_x
    # By Cayley-Hamilton n rows see all there is to see, and n more transitions forget all that they can.
    candidates = range(max(1, d), d + 2 * n + 1)
    shortest = next((k for k in candidates if start_length(fms_window(model, k, d), n + 1) is not None), None)
    rank = fms_window(model, min(M, n), 0).rank
    advice = f"the shortest M that works is {shortest}" if shortest else "no M does; measure another state"
    return UnobservableWindow(
        f"a window of M = {M} must determine x_{{i-{d}}} (n = {n}), its rows have rank {rank}; {advice}",
        rank=rank,
        shortest=shortest,
    )
