"""The linear model every estimator starts from, and two ways to get one."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ._arrays import (
    Array,
    check_covariance,
    covariance,
    dimension,
    finite,
    integer,
    matrix,
    number,
    readonly,
    real,
    square,
)
from .errors import ShapeError, UfirextError

__all__ = ["Model", "discretise", "kinematic"]


@dataclass(frozen=True, eq=False, repr=False)
class Model:
    """Linear discrete model  x_n = F x_{n-1} + B u_n + w_n,  z_n = H x_n + v_n, equation :eq:`plant`.

    A frozen value: its arrays are copies, read-only and validated, so that gains can be cached on it.

    Parameters
    ----------
    F : array_like, (dim_x, dim_x)
        State transition over one step. May be singular or unstable.
    H : array_like, (dim_z, dim_x)
        Measurement matrix.
    Q : array_like, (dim_x, dim_x), or scalar, optional
        Covariance of the process noise w, positive semidefinite, may be singular. Default 0. UFIR gains
        do not need it; covariances and the choice of a horizon do.
    R : array_like, (dim_z, dim_z), or scalar, optional
        Covariance of the measurement noise v. Default identity.
    B : array_like, (dim_x, dim_u), optional
        Input matrix.
    dt : float, optional
        Step in seconds; information only.

    Raises
    ------
    ShapeError, NonFiniteError, CovarianceError
        Subclasses of ValueError that name the argument, the expected shape and what came.

    Examples
    --------
    >>> from ufirext import Model
    >>> Model(F=[[1, 1], [0, 1]], H=[[1, 0]], R=4.0)
    Model(dim_x=2, dim_z=1)
    """

    F: Array
    H: Array
    Q: Array
    R: Array
    B: Array | None
    dt: float | None

    def __init__(
        self,
        F: ArrayLike,
        H: ArrayLike,
        Q: ArrayLike | None = None,
        R: ArrayLike | None = None,
        B: ArrayLike | None = None,
        dt: float | None = None,
    ) -> None:
        first = real(F, "F")
        size = first.shape[0] if first.ndim == 2 else 1
        if size == 0:
            raise ShapeError("F must have at least one state, got shape (0, 0)")
        values: dict[str, Any] = {
            "F": matrix(first, (size, size), "F", "(dim_x, dim_x)"),
            "H": matrix(np.atleast_2d(real(H, "H")), (None, size), "H", "(dim_z, dim_x)"),
        }
        rows = values["H"].shape[0]
        if rows == 0:
            raise ShapeError(f"H must have at least one row, got shape {values['H'].shape}")
        values["Q"] = covariance(0.0 if Q is None else Q, size, "Q", "(dim_x, dim_x)")
        values["R"] = covariance(1.0 if R is None else R, rows, "R", "(dim_z, dim_z)")
        values["B"] = None if B is None else matrix(_as_columns(B), (size, None), "B", "(dim_x, dim_u)")
        for name, value in values.items():
            object.__setattr__(self, name, value if value is None else readonly(value))
        object.__setattr__(self, "dt", None if dt is None else _seconds(dt))

    @property
    def dim_x(self) -> int:
        """Number of states."""
        return len(self.F)

    @property
    def dim_z(self) -> int:
        """Number of measured components."""
        return len(self.H)

    @property
    def dim_u(self) -> int:
        """Number of inputs."""
        return 0 if self.B is None else self.B.shape[1]

    def replace(self, **changes: Any) -> Model:
        """A copy with some of F, H, Q, R, B, dt changed.

        Examples
        --------
        >>> from ufirext import kinematic
        >>> kinematic(1, 1, 0.1).replace(R=9.0).R
        array([[9.]])
        """
        return replace(self, **changes)

    def __repr__(self) -> str:
        inputs = f", dim_u={self.dim_u}" if self.dim_u else ""
        step = f", dt={self.dt:g}" if self.dt is not None else ""
        return f"Model(dim_x={self.dim_x}, dim_z={self.dim_z}{inputs}{step})"

    def _key(self) -> tuple[Any, ...]:
        arrays = (self.F, self.H, self.Q, self.R, self.B)
        return (*((None if a is None else (a.shape, a.tobytes())) for a in arrays), self.dt)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Model) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())


def require_model(model: object) -> None:
    """Raise unless `model` is a Model."""
    if not isinstance(model, Model):
        raise UfirextError(
            f"model must be a ufirext.Model, got {type(model).__name__}; "
            "Model(F, H, Q, R) or kinematic() makes one"
        )


def _as_columns(B: ArrayLike) -> Array:
    array = real(B, "B")
    return array.reshape(-1, 1) if array.ndim < 2 else array


def _seconds(dt: float) -> float:
    seconds = number(dt, "dt")
    if not 0.0 < seconds < math.inf:
        raise UfirextError(f"dt must be a positive number of seconds, got {seconds}")
    return seconds


def kinematic(order: int, dim: int, dt: float, *, q: float = 1.0, r: float = 1.0) -> Model:
    """Constant position, velocity or acceleration in `dim` axes.

    The states are grouped by axis, [x, x', .., y, y', ..]; H measures the positions.

    Parameters
    ----------
    order : {0, 1, 2}
        0 constant position, 1 constant velocity, 2 constant acceleration.
    dim : int
        Number of axes.
    dt : float
        Step, s.
    q : float
        Spectral density of the white noise that drives the highest derivative (m^2/s^3 for order 1): the
        continuous model of Bar-Shalom, Li and Kirubarajan (2001), sections 6.2.2 and 6.2.3.
    r : float
        Variance of one measured position, m^2; R = r I.

    Returns
    -------
    Model

    Raises
    ------
    ValueError
        For an order outside 0..2, a dim below 1, a dt that is not positive, a negative q or r.

    Examples
    --------
    >>> from ufirext import kinematic
    >>> kinematic(1, 2, 0.5).F[:2, :2]
    array([[1. , 0.5],
           [0. , 1. ]])
    """
    order = integer(order, "order", 0, 2, "it is the highest derivative among the states", ShapeError)
    dim = dimension(dim, "dim", 1, "axes")
    dt = _seconds(dt)
    for name, value in (("q", q), ("r", r)):
        if not 0.0 <= number(value, name) < math.inf:
            raise UfirextError(f"{name} must be a finite number, not negative, got {value!r}")
    size = order + 1
    axis = np.array(
        [[dt ** (j - i) / math.factorial(j - i) if j >= i else 0.0 for j in range(size)] for i in range(size)]
    )
    noise = np.array([[_integrated(order - i, order - j, dt) for j in range(size)] for i in range(size)])
    eye = np.eye(dim)
    H = np.kron(eye, np.eye(1, size))
    return Model(np.kron(eye, axis), H, Q=np.kron(eye, q * noise), R=r * eye, dt=dt)


def _integrated(a: int, b: int, dt: float) -> float:
    """Integral of s^a/a! s^b/b! over [0, dt]."""
    return float(dt ** (a + b + 1) / ((a + b + 1) * math.factorial(a) * math.factorial(b)))


def discretise(A: ArrayLike, G: ArrayLike, Qc: ArrayLike, dt: float) -> tuple[Array, Array]:
    """Discrete F and Q of the continuous model  dx/dt = A x + G w,  w white with spectral density Qc.

    Van Loan's method: F = exp(A dt), Q = integral of exp(A s) G Qc G' exp(A s)' over [0, dt], equation
    :eq:`discretisation` (C. F. Van Loan, "Computing integrals involving the matrix exponential", IEEE TAC
    23(3), 1978).

    Parameters
    ----------
    A : array_like, (dim_x, dim_x)
    G : array_like, (dim_x, dim_w)
        Where the noise enters.
    Qc : array_like, (dim_w, dim_w), or scalar
        Spectral density, positive semidefinite.
    dt : float
        Step, s.

    Returns
    -------
    F, Q : ndarray, (dim_x, dim_x)

    Raises
    ------
    ValueError
        For wrong shapes, values that are not finite, an indefinite Qc, or a dt that is not positive.

    Examples
    --------
    >>> from ufirext import discretise
    >>> F, Q = discretise([[0, 1], [0, 0]], [[0], [1]], 3.0, dt=1.0)
    >>> Q
    array([[1. , 1.5],
           [1.5, 3. ]])
    """
    from scipy.linalg import expm

    dt = _seconds(dt)
    drift = real(A, "A")
    size = drift.shape[0] if drift.ndim == 2 else 1
    drift = matrix(drift, (size, size), "A", "(dim_x, dim_x)")
    spread = matrix(_as_columns(G), (size, None), "G", "(dim_x, dim_w)")
    density = square(Qc, spread.shape[1], "Qc", "(dim_w, dim_w)")
    check_covariance(density, "Qc")
    block = np.block([[-drift, spread @ density @ spread.T], [np.zeros((size, size)), drift.T]])
    exponential = finite(expm(block * dt), "exp(A dt)")
    F = exponential[size:, size:].T
    Q = F @ exponential[:size, size:]
    return F, 0.5 * (Q + Q.T)
