"""Which couplings between states are rounding: what cos(pi / 2) leaves must not pass for an observation.

A rotation by pi as it comes out of floating-point arithmetic couples two states by 1e-16 either way. In
scaled coordinates that is as good as any coupling, and rows that see one state seem to determine both: with a
gain of 1e16. Units cannot tell: a state in units 1e16 times as large has one such coupling for good reason,
but then the one back is 1e-32. It is their product, which no units change, that shows rounding.
"""

from __future__ import annotations

import numpy as np

from ._arrays import Array

__all__ = ["EPS", "SUSPECT", "carried_rounding", "drowned", "without_rounding"]

# Units of rounding, times the number of products, up to which two couplings are nothing.
ULPS = 4.0
EPS = float(np.finfo(float).eps)
# ... and what they may be at most in the units given, beside the diagonal.
SMALL = 1e-6
# Diagonal entries of normal equations whose ratio is below this may stem from such couplings: methods that
# square the condition leave these to the one that looks.
SUSPECT = 1e-22
# Diagonal entries no larger than so many times their rounding are not trusted.
ROUNDINGS = 30.0


def carried_rounding(A: Array, J: Array, rounding: Array) -> Array:
    """What rounding may leave on the diagonal of A' J A, where J has that much already, (n,).

    Directions that cancel there leave about eps of the largest term, (|A|' sqrt(eps diag J))^2.
    """
    size: Array = np.abs(A).T.dot(np.sqrt(EPS * np.abs(J.diagonal()) + rounding))
    return size * size


def drowned(J: Array, rounding: Array) -> bool:
    """Whether an entry of the diagonal that is not zero is hardly more than its rounding, or may stem from
    couplings that are rounding.
    """
    entries = J.diagonal()
    seen = entries > 0.0
    least = np.maximum(ROUNDINGS * rounding, SUSPECT * entries.max(initial=0.0))
    return bool((entries < least)[seen].any())


def without_rounding(products: Array) -> Array:
    """Transitions over 0, 1, 2, .. steps, (steps, n, n), without the couplings that are rounding."""
    diagonal = np.abs(np.einsum("kii->ki", products))
    size = diagonal[:, :, None] * diagonal[:, None, :]
    turned = products.transpose(0, 2, 1)
    allowed = (ULPS * EPS * np.arange(1, len(products) + 1)[:, None, None]) ** 2 * size
    small = np.maximum(np.abs(products), np.abs(turned)) <= SMALL * np.sqrt(size)
    rounding = small & (np.abs(products) * np.abs(turned) <= allowed) & (products != 0.0) & (turned != 0.0)
    return np.where(rounding, 0.0, products) if rounding.any() else products
