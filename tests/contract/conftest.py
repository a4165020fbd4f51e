"""Which classes keep the contract, and in which forms of ``x`` it is asked of them.

``make`` runs through every class with filterpy's face, filterpy's own first: a test that the model
itself fails is a wrong test. Where the library is better than filterpy, the test carries
``contract(item, better=True)`` and filterpy is not asked.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

import ufirext

HORIZONS = (4, 8, 10, 40)


@dataclass(frozen=True)
class Face:
    """A class with filterpy's face: ``make(dim_x, dim_z, dim_u)`` builds one of its filters."""

    name: str
    build: Callable[..., Any]
    horizon: int | None = None  # None: infinite memory

    def __call__(self, *dims: int, **options: Any) -> Any:
        return self.build(*dims, **options)

    def __str__(self) -> str:
        return self.name


def _ufir(*dims: int, **options: Any) -> Any:
    return ufirext.UFIRFilter(*dims, **options)


FILTERPY = Face("filterpy", KalmanFilter)
UFIR = tuple(Face(f"ufir-{n}", partial(_ufir, horizon=n), n) for n in HORIZONS)
FACES = (FILTERPY, *UFIR)


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line(
        "markers",
        "contract(item, better=False): an item of the contract; better: filterpy fails it and is not asked",
    )


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    marker = metafunc.definition.get_closest_marker("contract")
    if "make" in metafunc.fixturenames:
        better = marker is not None and marker.kwargs.get("better", False)
        metafunc.parametrize("make", FACES[1:] if better else FACES, ids=str)
    if "ufir" in metafunc.fixturenames:
        metafunc.parametrize("ufir", UFIR, ids=str)
    if "column" in metafunc.fixturenames:
        metafunc.parametrize("column", [True, False], ids=["column", "flat"])


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20)
