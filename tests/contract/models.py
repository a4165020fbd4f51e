"""Filters on the models that trackers use, set up the way filterpy's users do, and their truths."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def vector(values: ArrayLike, column: bool) -> Array:
    """``values`` as a column (n, 1) or flat (n,)."""
    flat = np.array(values, dtype=float).ravel()
    return flat[:, None] if column else flat


def ramp_F(dt: float = 1.0) -> Array:
    return np.array([[1.0, dt], [0.0, 1.0]])


def constant_velocity(
    make: Any, column: bool = True, *, x0: ArrayLike = (0, 0), q: float = 0.01, **more: Any
) -> Any:
    """[position, velocity], the position measured; dim_x = 2, dim_z = 1."""
    f = make(2, 1, **more)
    f.x = vector(x0, column)
    f.P *= 100.0
    f.F = ramp_F()
    f.H = np.array([[1.0, 0.0]])
    f.Q = q * np.array([[1 / 3, 1 / 2], [1 / 2, 1.0]])
    f.R *= 4.0
    return f


def plane(
    make: Any, column: bool = True, *, x0: ArrayLike = (0, 0, 0, 0), q: float = 0.01, **more: Any
) -> Any:
    """[x, vx, y, vy], both positions measured; dim_x = 4, dim_z = 2."""
    f = make(4, 2, **more)
    f.x = vector(x0, column)
    f.P *= 100.0
    f.F = np.kron(np.eye(2), ramp_F())
    f.H[0, 0] = f.H[1, 2] = 1.0
    f.Q = q * np.kron(np.eye(2), [[1 / 3, 1 / 2], [1 / 2, 1.0]])
    f.R = np.diag([4.0, 1.0])
    return f


def trajectory(F: Array, x0: ArrayLike, steps: int) -> Array:
    """Noise-free states x_1 .. x_steps of x_n = F x_{n-1}; (steps, dim_x)."""
    states, x = [], np.array(x0, dtype=float)
    for _ in range(steps):
        x = F @ x
        states.append(x)
    return np.array(states)


def walk(rng: np.random.Generator, steps: int, width: int) -> list[Array]:
    """Noisy measurements of ``width`` ramps, one (width,) a step."""
    slopes = np.arange(1, width + 1)
    return [slopes * n + rng.standard_normal(width) for n in range(steps)]


def run(f: Any, zs: Any) -> Any:
    for z in zs:
        f.predict()
        f.update(z)
    return f


def flat(x: ArrayLike) -> Array:
    return np.array(x, dtype=float).ravel()


PUBLISHED = ("x", "P", "x_prior", "P_prior", "x_post", "P_post", "y", "S", "SI", "K", "z")


def snapshot(f: Any) -> dict[str, Any]:
    """Copies of everything that a filter publishes."""
    numbers = {name: getattr(f, name) for name in ("log_likelihood", "likelihood", "mahalanobis")}
    return {name: np.array(getattr(f, name), copy=True) for name in PUBLISHED} | numbers


def assert_same(f: Any, g: Any, tolerance: float = 1e-9) -> None:
    """Everything published by f and g is equal."""
    a, b = snapshot(f), snapshot(g)
    for name in a:
        if name == "z":
            np.testing.assert_array_equal(a[name], b[name], err_msg=name)
        else:
            scale = 1.0 + np.max(np.abs(b[name]), initial=0.0)
            np.testing.assert_allclose(a[name], b[name], rtol=tolerance, atol=tolerance * scale, err_msg=name)
