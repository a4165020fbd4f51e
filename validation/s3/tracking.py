"""The tracking model of Kim (2019), section 3, equation (16)."""

from __future__ import annotations

import numpy as np

from ufirext import FMSGain, Model, fms_gain

__all__ = ["RUNS", "STEPS", "A", "C", "D", "G", "M", "Q", "R", "gain", "model"]

T = 2.0
A = np.array([[1.0, T, T**2 / 2], [0.0, 1.0, T], [0.0, 0.0, 1.0]])
C = np.array([[1.0, 0.0, 0.0]])
G = np.array([[T / 2, 0.0], [1.0, 0.0], [0.0, 1.0]])
Q = np.diag([0.173**2, 0.01**2])
R = 0.05**2
M, D = 15, 5
RUNS, STEPS = 30, 800


def model() -> Model:
    """The paper's A, C and G Q G' as F, H and Q; a step is T = 2 s."""
    return Model(A, C, G @ Q @ G.T, R, dt=T)


def gain(window: int = M, lag: int = D) -> FMSGain:
    """The unified gain, of the paper's window and lag unless told otherwise."""
    return fms_gain(A, C, Q, R, window, lag, G=G)
