"""Model files: a linear model, a window and perhaps a gain of one's own, in TOML or JSON."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

from ._arrays import matrix
from .errors import UfirextError
from .fms import FMSGain, fms_gain
from .gains import Gain, exact_covariance, ufir_gain
from .minimum_variance import MinimumVarianceGain, minimum_variance_gain
from .model import Model
from .window import model_window

__all__ = ["ModelFileError", "read_gain"]

OURS = {"F", "H", "Q", "R", "B", "horizon", "lag", "kind", "gain"}
PAPERS = {"A", "C", "Q", "R", "M", "d", "B", "G", "gain"}
KINDS = ("minimum variance", "ufir")


class ModelFileError(UfirextError):
    """A model file cannot be read or does not say what is needed."""


def read_gain(path: Path, horizon: int | None = None, lag: int | None = None) -> tuple[Gain | FMSGain, Model]:
    """The gain a model file asks for, and its model.

    Keys are either this library's (F, H, Q, R, B, horizon, lag, kind = "minimum variance" or "ufir") or those
    of the FMS paper (A, C, Q, R, B, G, M, d). `gain`, a matrix, replaces the designed gain by one to judge.

    Parameters
    ----------
    path : Path
        Ending in .toml or .json.
    horizon, lag : int, optional
        Replace horizon and lag (M and d) of the file.

    Raises
    ------
    ModelFileError
        If the file cannot be read, or a key is missing, unknown or not a matrix.
    UfirextError
        What the design itself refuses.
    """
    said = _parsed(path)
    papers = "A" in said or "C" in said
    known, needed = (PAPERS, ("A", "C", "Q", "R")) if papers else (OURS, ("F", "H", "Q", "R"))
    unknown = sorted(set(said) - known)
    if unknown:
        raise ModelFileError(
            f"{path}: keys must be among {', '.join(sorted(known))}, got {', '.join(unknown)}"
        )
    names = ("M", "d") if papers else ("horizon", "lag")
    for name, value in zip(names, (horizon, lag), strict=True):
        if value is not None:
            said[name] = value
    missing = [name for name in (*needed, names[0]) if name not in said]
    if missing:
        raise ModelFileError(f"{path}: must say {', '.join(missing)}, which is missing")
    return _papers_gain(said) if papers else _our_gain(path, said)


def _papers_gain(said: dict[str, Any]) -> tuple[FMSGain, Model]:
    own = said.pop("gain", None)
    gain = fms_gain(**{"d": 0, **said})
    if own is not None:
        gain = replace(gain, H=matrix(own, gain.H.shape, "gain", "(2 n, M q)"))
    return gain, gain.model


def _our_gain(path: Path, said: dict[str, Any]) -> tuple[Gain, Model]:
    kind = said.get("kind", KINDS[0])
    if kind not in KINDS:
        raise ModelFileError(f"{path}: kind must be {' or '.join(map(repr, KINDS))}, got {kind!r}")
    model = Model(said["F"], said["H"], said["Q"], said["R"], said.get("B"))
    horizon, lag = said["horizon"], said.get("lag", 0)
    gain = (ufir_gain if kind == "ufir" else minimum_variance_gain)(model, horizon, lag)
    if "gain" not in said:
        return gain, model
    K = matrix(said["gain"], gain.K.shape, "gain", "(dim_x, horizon * dim_z)")
    P = exact_covariance(model_window(model, horizon, lag), K)
    if isinstance(gain, MinimumVarianceGain):
        # A gain for the lagged state alone: the filtered one stays the library's.
        now: dict[str, Any] = {"K_now": K, "P_now": P, "P_cross": P} if lag == 0 else {}
        return replace(gain, K=K, G=K @ K.T, P=P, **now), model
    return Gain(K, K @ K.T, P, horizon, lag), model


def _parsed(path: Path) -> dict[str, Any]:
    readers = {".toml": tomllib.loads, ".json": json.loads}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise ModelFileError(f"a model file must end in .toml or .json, got {path}")
    try:
        said = reader(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ModelFileError(f"{path} cannot be read: {error.strerror}") from error
    except ValueError as error:  # of tomllib, json and the decoding alike
        raise ModelFileError(f"{path} is not {path.suffix[1:].upper()}: {error}") from error
    if not isinstance(said, dict):
        raise ModelFileError(f"{path} must hold named matrices, got {type(said).__name__}")
    return said
