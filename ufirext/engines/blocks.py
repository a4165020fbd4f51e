"""Blocks of associative elements: a boundary, the sum of what came after, suffixes of what came before.

Everything is in the coordinates [x; 1]: a transition is E = [[F, known], [0, 1]], a whitened row B with
B [x; 1] = noise, so that known inputs need no thought. Rows after the boundary t are summed up in the frame
of x_f, f <= t (forward products only); rows up to t are kept as a table of suffixes, each in the frame of its
oldest origin. A window is one suffix and the sum.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._arrays import Array


class Suffix(NamedTuple):
    """Sum of B'B over the rows after a bound, up to the boundary, in the frame of x_a; and Phi(f, a)."""

    sum: Array
    lead: Array


class Block:
    """A boundary t, the sum of what came after it, and the suffixes before it."""

    def __init__(self, boundary: int, frame: int, dim_x: int) -> None:
        self.boundary, self.frame = boundary, frame
        self.sum = np.zeros((dim_x + 1, dim_x + 1))
        self.products = [np.eye(dim_x + 1)]  # Phi(frame + j, frame)
        self.suffixes = [Suffix(self.sum.copy(), self.products[0])]
        self.oldest = frame

    def advance(self, E: Array) -> None:
        """One more transition."""
        self.products.append(E.dot(self.products[-1]))

    def move(self, delta: Array) -> None:
        """x of now was moved by delta."""
        moved = self.products[-1].copy()
        moved[:-1, -1] += delta
        self.products[-1] = moved

    def add(self, origin: int, gram: Array) -> None:
        """B'B of a row after the boundary."""
        product = self.products[origin - self.frame]
        self.sum += product.T.dot(gram.dot(product))

    def window(self, bound: int) -> tuple[Array, Array]:
        """The rows after `bound`: sum of B'B in the frame of their oldest state, and Phi from it to now."""
        older, lead = self.suffixes[self.boundary - bound]
        return older + lead.T.dot(self.sum.dot(lead)), self.products[-1].dot(lead)
