"""Normal equations of windows with holes and weights, in an orthonormal basis of the full window."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .._arrays import Array
from .._lapack import cholesky_solver
from ..model import Model
from ..window import model_window

__all__ = ["WEAK_PIVOT", "Basis", "Memory"]

# A pivot below this (the full window's are 1) means that the rows present are too few for normal equations.
WEAK_PIVOT = 1e-3
# Grams with more numbers than this are worth a factorisation: their entries follow few modes of F.
LARGE = 4096
# Bytes of gains that a memory holds; of a number; of what a gain takes besides its numbers.
MEMORY, FLOAT, OVERHEAD = 2**21, 8, 400
# Modes below this fraction of the largest are rounding.
ROUNDING = 1e-15


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

    def solver(self, columns: bool = False) -> Callable[[Array, Array], Array | None]:
        """solve(weights, free): x of weights (length,) and weighted measurements, oldest first; None where
        the rows are too few for normal equations.

        `free` is (length dim_z,) or, with `columns`, (length dim_z, 1), and so is x. Every solver has a
        buffer of its own.
        """
        r = self.rank
        if not self.sound:
            return _nothing
        factorise: Any = cholesky_solver()
        project, back = self.project.dot, self.back.dot
        gram, *inner = (factor.dot for factor in self.grams)
        # Lam, overwritten by its factor, and eta, overwritten by the solution, where LAPACK wants them to be.
        flat, eta = np.zeros(r * r), np.zeros((r, 1) if columns else r)
        matrix, pivots, right = flat.reshape(r, r).T, flat[:: r + 1], eta.reshape(r, 1)

        def solve(weights: Array, free: Array) -> Array | None:
            for factor in inner:
                weights = factor(weights)
            gram(weights, flat)
            project(free, eta)
            if factorise(matrix, right, 0, 1, 1)[2] or min(pivots.tolist()) < WEAK_PIVOT:
                return None
            x: Array = back(eta)
            return x

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


def _factors(grams: Array) -> tuple[Array, ...]:
    """(grams,), or two factors of it, outer first, where that is less work."""
    if grams.size <= LARGE:
        return (grams,)
    U, s, Vt = np.linalg.svd(grams, full_matrices=False)
    modes = int(np.count_nonzero(s > ROUNDING * s[0]))
    if 2 * modes * sum(grams.shape) > grams.size:
        return (grams,)
    return np.ascontiguousarray(U[:, :modes] * s[:modes]), np.ascontiguousarray(Vt[:modes])
