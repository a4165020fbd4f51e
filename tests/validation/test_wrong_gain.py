"""A suite that a wrong gain passes would be worth nothing: one sign is flipped, and it must fail."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from validation import cli
from validation.s3 import simulation


def flipped(K: Any) -> Any:
    """The gain with one sign flipped for each state: that of its largest weight."""
    wrong = np.array(K)
    rows = np.arange(len(wrong))
    wrong[rows, np.abs(wrong).argmax(axis=1)] *= -1.0
    return wrong


def of_joint(right: Callable[..., Any]) -> Callable[..., Any]:
    def joint_gain(*args: Any) -> Any:
        joint = right(*args)
        return replace(joint, K=flipped(joint.K))

    return joint_gain


def of_array(right: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *args: flipped(right(*args))


def of_pair(right: Callable[..., Any]) -> Callable[..., Any]:
    def gain(*args: Any) -> Any:
        K, factor = right(*args)
        return flipped(K), factor

    return gain


def status(item: str, folder: Path) -> int:
    arguments = ["--only", item, "--out", str(folder), "--jobs", "1"]
    return CliRunner().invoke(cli.app, arguments).exit_code


@pytest.fixture
def forget() -> Any:
    """The settled Kalman gain is computed once: forget it before and after."""
    simulation.steady.cache_clear()
    yield
    simulation.steady.cache_clear()


@pytest.mark.usefixtures("forget")
@pytest.mark.parametrize(
    ("module", "function", "wrong", "item"),
    [
        ("ufirext.fms", "joint_gain", of_joint, "s3-fig-1"),
        ("ufirext.gains", "constant_gain", of_array, "s0-fig-4"),
        ("ufirext.gains", "constant_gain", of_array, "beyond-certificates"),
        ("ufirext.recursions.kalman", "_gain", of_pair, "errata-s0"),
    ],
)
def test_one_flipped_sign_fails_the_suite(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, module: str, function: str, wrong: Any, item: str
) -> None:
    home = importlib.import_module(module)
    assert status(item, tmp_path) == 0
    monkeypatch.setattr(home, function, wrong(getattr(home, function)))
    assert status(item, tmp_path) == 1
