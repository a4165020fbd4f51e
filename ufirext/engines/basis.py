"""Normal equations of windows with holes and weights, in an orthonormal basis of the full window."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from .._arrays import Array
from .._lapack import cholesky_solver
from ..model import Model
from ..window import model_window

__all__ = ["WEAK_PIVOT", "Basis", "Memory", "Solve"]

# A pivot below this (the full window's are 1) means that the rows present are too few for normal equations.
WEAK_PIVOT = 1e-3
# Grams with more numbers than this are worth a factorisation: their entries follow few modes of F.
LARGE = 4096
# Bytes of gains that a memory holds; of a number; of what a gain takes besides its numbers.
MEMORY, FLOAT, OVERHEAD = 2**21, 8, 400
# Modes below this fraction of the largest are rounding.
ROUNDING = 1e-15
# Coordinates of x no further from orthogonal than this (a condition number, its square that of the normal
# equations) cost them no digits that matter.
SKEW = 10.0

Solve = Callable[[Array, Array], Array | None]
"""x of weights (length,) and weighted measurements, oldest first; None where the rows are too few for normal
equations."""


class Basis:
    """An orthonormal basis of the full window of `length` steps, for windows with holes and weights.

    With the whitened rows C = U S V' of the window, rows present with weights w_i give
    x = back Lam^-1 sum_i w_i U_i' W z_i,  Lam = sum_i w_i U_i' U_i: close to the identity, so that normal
    equations lose nothing where few rows are missing.
    """

    def __init__(self, model: Model, length: int) -> None:
        window = model_window(model, length)
        U, s, Vt = window.spectrum
        r = window.rank
        self.length, self.rank = length, r
        blocks = U[:, :r].reshape(length, model.dim_z, r)
        self.back = np.ascontiguousarray((window.T / window.scale) @ (Vt[:r].T / s[:r]))
        # eta = project @ (weighted raw measurements), Lam = the product of all `grams` with the weights
        self.project = np.ascontiguousarray((window.W[0].T @ blocks).reshape(-1, r).T)
        grams = (blocks.transpose(0, 2, 1) @ blocks).reshape(length, -1).T
        self.grams = _factors(np.ascontiguousarray(grams))
        self.sound = window.determined() and r > 0

    @cached_property
    def direct(self) -> tuple[tuple[Array, ...], Array] | None:
        """`grams` and `project` in the coordinates of x, whose solution is x itself; None where these are not
        good enough.
        """
        if _skew(self.back) >= SKEW:
            return None
        turn = np.linalg.inv(self.back).T
        outer, *inner = self.grams
        return (np.kron(turn, turn) @ outer, *inner), turn @ self.project

    def gain(self, weights: Array) -> Array | None:
        """x = gain @ (weighted measurements); None where a solver finds too few rows."""
        if not self.sound:
            return None
        for factor in self.grams[::-1]:
            weights = factor.dot(weights)
        matrix = weights.reshape(self.rank, self.rank)
        factor, solution, info = cholesky_solver()(matrix, self.project)
        if info or factor.diagonal().min() < WEAK_PIVOT:
            return None
        return np.ascontiguousarray(self.back @ solution)

    def solver(self, columns: bool = False, holes: bool = True) -> Solve:
        """solve(weights, free): x of weights (length,) and weighted measurements, oldest first.

        `free` is (length dim_z,) or, with `columns`, (length dim_z, 1), and so is x. Without `holes` every
        row must have come, with a weight not far from 1: such rows are never too few. Every solver has a
        buffer of its own.
        """
        if not self.sound:
            return _nothing
        grams, project = self.grams, self.project.dot
        back: Any = self.back.dot
        if not holes and self.direct is not None:
            grams, project, back = self.direct[0], self.direct[1].dot, None
        factorise: Any = cholesky_solver()
        gram, *inner = (factor.dot for factor in grams)
        # Lam, overwritten by its factor where LAPACK wants it to be.
        r = self.rank
        flat = np.zeros(r * r)
        matrix, pivots = flat.reshape(r, r).T, flat[:: r + 1]

        def solve(weights: Array, free: Array) -> Array | None:
            for factor in inner:
                weights = factor(weights)
            gram(weights, flat)
            solution: Array
            _, solution, failed = factorise(matrix, project(free), 0, 1, 1)
            if failed or (holes and min(pivots.tolist()) < WEAK_PIVOT):
                return None
            return solution if back is None else back(solution)

        return solve


class Memory:
    """Gains of patterns of weights that come up again and again.

    Which these are is a matter of the pattern alone, so that equal windows give equal bits: all patterns of
    a short window, and those of a network that delays but loses nothing, where every slot has its row but the
    newest and oldest `spread` ones. `least`: patterns with fewer rows are left out.
    """

    def __init__(self, basis: Basis, least: int, spread: int) -> None:
        self.basis, self.least = basis, least
        length = basis.length
        room = MEMORY // (FLOAT * (basis.back.shape[0] * basis.project.shape[1] + length) + OVERHEAD)
        self.room = room
        self.short = length < room.bit_length()
        self.inner = slice(FLOAT * spread, FLOAT * (length - spread))
        self.full = np.ones(max(length - 2 * spread, 0)).tobytes()
        late = 0 < 2 * spread < min(length, room.bit_length())
        self.recalls = basis.sound and (self.short or late)
        self.known: dict[bytes, Callable[[Array], Array]] = {}

    def recall(self, weights: bytes) -> Callable[[Array], Array] | None:
        """x as a function of the weighted measurements, None for a pattern that is not to be remembered."""
        product = self.known.get(weights)
        if product is None and self.recalls and (self.short or weights[self.inner] == self.full):
            present = np.frombuffer(weights)
            gain = self.basis.gain(present) if np.count_nonzero(present) >= self.least else None
            if gain is None:
                return None
            if len(self.known) >= self.room:
                self.known.clear()
            product = self.known[weights] = gain.dot
        return product


def _nothing(weights: Array, free: Array) -> Array | None:
    return None


def _skew(back: Array) -> float:
    """How far the components of x are from being uncorrelated in the full window."""
    sizes = np.linalg.norm(back, axis=1, keepdims=True)
    square = back.shape[0] == back.shape[1] and sizes.all()
    return float(np.linalg.cond(back / sizes)) if square else np.inf


def _factors(grams: Array) -> tuple[Array, ...]:
    """(grams,), or two factors of it, outer first, where that is less work."""
    if grams.size <= LARGE:
        return (grams,)
    U, s, Vt = np.linalg.svd(grams, full_matrices=False)
    modes = int(np.count_nonzero(s > ROUNDING * s[0]))
    if 2 * modes * sum(grams.shape) > grams.size:
        return (grams,)
    return np.ascontiguousarray(U[:, :modes] * s[:modes]), np.ascontiguousarray(Vt[:modes])
