"""Blocks of associative elements: a boundary, the sum of what came after, suffixes of what came before.

Rows after the boundary t are summed up in the frame of x_f, f <= t (forward products only); rows up to t are
kept as a table of suffixes, each in the frame of its oldest origin. A window is one suffix and the sum.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .._arrays import Array


class Suffix(NamedTuple):
    """Information on x_a from the rows after a bound, up to the boundary: Lam, eta, and Phi(f, a)."""

    Lam: Array
    eta: Array
    lead: Array


class Block:
    """A boundary t, the sums of what came after it, and the suffixes before it."""

    def __init__(self, boundary: int, frame: int, dim_x: int) -> None:
        self.boundary, self.frame = boundary, frame
        self.Lam, self.eta = np.zeros((dim_x, dim_x)), np.zeros(dim_x)
        self.products = [np.eye(dim_x)]  # Phi(frame + j, frame)
        self.suffixes = [Suffix(self.Lam.copy(), self.eta.copy(), self.products[0])]
        self.oldest = frame

    def advance(self, F: Array) -> None:
        """One more transition."""
        self.products.append(F.dot(self.products[-1]))

    def add(self, origin: int, H: Array, z: Array) -> None:
        """A whitened row after the boundary."""
        A = H.dot(self.products[origin - self.frame])
        self.Lam += A.T.dot(A)
        self.eta += z.dot(A)
