"""The classes that filterpy code is run with; filterpy's own is one: what is asserted holds there too."""

from __future__ import annotations

import importlib.util
import sys
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

import ufirext

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def ufir(*dims: int, horizon: int | str, **options: Any) -> Any:
    return ufirext.UFIRFilter(*dims, horizon=horizon, **options)


CLASSES = {
    "filterpy": KalmanFilter,
    "ufir-auto": partial(ufir, horizon="auto"),
    "ufir-8": partial(ufir, horizon=8),
    "ufir-40": partial(ufir, horizon=40),
}


@pytest.fixture(params=CLASSES.values(), ids=CLASSES)
def make(request: pytest.FixtureRequest) -> Any:
    return request.param


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


@pytest.fixture(scope="session")
def sort_boxes() -> ModuleType:
    """The example, imported as a module: its scenes and scores serve the trackers' tests too."""
    spec = importlib.util.spec_from_file_location("sort_boxes", EXAMPLES / "sort_boxes.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["sort_boxes"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module
