"""What all tests share: the Hypothesis profiles and the folder of recorded tracks."""

from __future__ import annotations

import gc
import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# Slow machines must not decide whether a test passes, so nothing here is timed.
_UNTIMED = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile("ci", derandomize=True, **_UNTIMED)
settings.register_profile("explore", max_examples=1000, print_blob=True, **_UNTIMED)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))


def pytest_collection_finish() -> None:
    """Spare the collector the tests themselves, which live as long as the session: a third of its time."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def tracks() -> Path:
    """The folder with recorded tracks that the environment variable UFIREXT_DATA names."""
    folder = os.environ.get("UFIREXT_DATA")
    if not folder:
        pytest.skip("UFIREXT_DATA is not set: it names the folder of recorded tracks")
    path = Path(folder)
    if not path.is_dir():
        pytest.fail(f"UFIREXT_DATA must name a folder, got {folder!r}")
    return path
