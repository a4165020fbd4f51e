"""Oracles for late measurements, naive and free of the library's formulas.

A plant with noises is one linear map of d = [x_0; w_1; ..; w_T; v_1; ..]; so is every measurement, and so
is every linear filter's error. Covariances and best estimates then are plain matrix algebra.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

# One axis of the vehicle in the plane: constant velocity, 1 s.
F1 = np.array([[1.0, 1.0], [0.0, 1.0]])
Q1 = 4.0 * np.array([[0.5, 0.5], [0.5, 1.0]])
H1 = np.array([[1.0, 0.0]])
R1 = np.array([[3.75**2]])


class Arrival(NamedTuple):
    """A measurement of the state at `origin` that comes at step `step`."""

    step: int
    origin: int


class World:
    """States and measurements of a constant plant as maps of the disturbances, of covariance `cov`."""

    def __init__(self, F, H, Q, R, P0, steps: int, arrivals: Sequence[Arrival]) -> None:
        n, m = len(F), len(H)
        self.arrivals = list(arrivals)
        size = n * (steps + 1) + m * len(self.arrivals)
        self.states = [np.zeros((n, size)) for _ in range(steps + 1)]
        self.states[0][:, :n] = np.eye(n)
        for t in range(1, steps + 1):
            self.states[t] = F @ self.states[t - 1]
            self.states[t][:, n * t : n * (t + 1)] = np.eye(n)
        self.measured = []
        for i, arrival in enumerate(self.arrivals):
            z = H @ self.states[arrival.origin]
            z[:, n * (steps + 1) + m * i :][:, :m] += np.eye(m)
            self.measured.append(z)
        self.cov = np.zeros((size, size))
        self.cov[:n, :n] = P0
        for t in range(1, steps + 1):
            self.cov[n * t : n * (t + 1), n * t : n * (t + 1)] = Q
        for i in range(len(self.arrivals)):
            at = slice(n * (steps + 1) + m * i, n * (steps + 1) + m * (i + 1))
            self.cov[at, at] = R

    def known_at(self, step: int) -> list[int]:
        """Numbers of the measurements that have come by `step`."""
        return [i for i, arrival in enumerate(self.arrivals) if arrival.step <= step]

    def best(self, step: int) -> np.ndarray:
        """The linear minimum-variance estimate of the state at `step`, as a map of the disturbances."""
        known = self.known_at(step)
        if not known:
            return np.zeros_like(self.states[step])
        Z = np.vstack([self.measured[i] for i in known])
        return np.linalg.solve(Z @ self.cov @ Z.T, Z @ self.cov @ self.states[step].T).T @ Z

    def covariance(self, estimate: np.ndarray, step: int) -> np.ndarray:
        """Of the error of an estimate that is a map of the disturbances."""
        error = self.states[step] - estimate
        return error @ self.cov @ error.T


def random_arrivals(rng, steps: int, longest: int, *, lost: float = 0.2) -> list[Arrival]:
    """Every measurement once, up to `longest` steps late, some never: out of order, several in a step."""
    arrivals = [
        Arrival(origin + int(rng.integers(0, longest + 1)), origin)
        for origin in range(1, steps + 1)
        if rng.random() >= lost
    ]
    return sorted((a for a in arrivals if a.step <= steps), key=lambda a: (a.step, rng.random()))


def constant_arrivals(steps: int, delay: int) -> list[Arrival]:
    """Every measurement, `delay` steps late."""
    return [Arrival(step, step - delay) for step in range(delay + 1, steps + 1)]
