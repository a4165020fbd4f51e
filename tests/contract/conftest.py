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

from ufirext.filters.fms import FMSFilterSmoother
from ufirext.filters.hinfinity import DelayHInfinityFilter
from ufirext.filters.kalman import DelayKalmanFilter
from ufirext.filters.ufir import UFIRFilter

HORIZONS = (4, 8, 10, 40)


@dataclass(frozen=True)
class Face:
    """A class with filterpy's face: ``make(dim_x, dim_z, dim_u)`` builds one of its filters."""

    name: str
    build: Callable[..., Any]
    horizon: int | None = None  # None: infinite memory
    kalman: bool = True  # starts as the Kalman filter of x, P, Q, R

    def __call__(self, *dims: int, **options: Any) -> Any:
        return self.build(*dims, **options)

    def __str__(self) -> str:
        return self.name


FILTERPY = Face("filterpy", KalmanFilter)
UFIR = tuple(Face(f"ufir-{n}", partial(UFIRFilter, horizon=n), n) for n in HORIZONS)
OTHERS = (
    Face("ufir-late", partial(UFIRFilter, horizon=8, max_delay=3), 8),
    Face("fms", partial(FMSFilterSmoother, horizon=9, lag=2), 9),
    Face("delay-kalman", partial(DelayKalmanFilter, max_delay=3)),
    Face("delay-hinfinity", DelayHInfinityFilter, kalman=False),
    Face("delay-hinfinity-late", partial(DelayHInfinityFilter, max_delay=2), kalman=False),
)
FACES = (FILTERPY, *UFIR, *OTHERS)


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line(
        "markers",
        "contract(item, better=False, kalman=False): an item; better: filterpy fails it and is "
        "not asked; kalman: only classes that start as a Kalman filter are asked",
    )


def _asked(marker: pytest.Mark | None) -> list[Face]:
    options = marker.kwargs if marker else {}
    faces = FACES[1:] if options.get("better") else FACES
    return [face for face in faces if face.kalman or not options.get("kalman")]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "make" in metafunc.fixturenames:
        metafunc.parametrize("make", _asked(metafunc.definition.get_closest_marker("contract")), ids=str)
    if "ufir" in metafunc.fixturenames:
        metafunc.parametrize("ufir", UFIR, ids=str)
    if "column" in metafunc.fixturenames:
        metafunc.parametrize("column", [True, False], ids=["column", "flat"])


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20)
