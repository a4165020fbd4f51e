"""`ufirext certify FILE`: whether the gain of a model file is the best unbiased one."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from .certificates import LIMIT, SOLVER_LIMIT, Certificate, UnconfirmedWarning
from .certificates import certify as certified
from .errors import UfirextError
from .fms import FMSGain
from .gains import Gain
from .model_file import read_gain

__all__ = ["certify"]

_OBJECTIVE = (
    "What to minimise: the trace of P, its largest eigenvalue, or the variance of one row of the gain, "
    "counted from 0 (of a pair those of x_now first, then those of x_lag)."
)
_CRITERIA = {
    "variance": "error variance",
    "noise": "noise of the measurements alone, P without process noise",
}


def certify(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A model in TOML or JSON.")],
    horizon: Annotated[int | None, typer.Option(help="Replace the file's horizon (M).")] = None,
    lag: Annotated[int | None, typer.Option(help="Replace the file's lag (d).")] = None,
    objective: Annotated[str, typer.Option(metavar="trace|lambda_max|ROW", help=_OBJECTIVE)] = "trace",
    solver: Annotated[str, typer.Option(help="A solver of cvxpy.")] = "CLARABEL",
) -> None:
    """Certify that a gain is the best unbiased one.

    FILE holds F, H, Q, R and horizon (lag, B, kind = "ufir"), or A, C, Q, R and M (d, B, G) as in the FMS
    paper. The gain is designed from them, or given as `gain`. The exit status is 1 unless it is confirmed.
    """
    try:
        gain, model = read_gain(file, horizon, lag)
        with warnings.catch_warnings():
            # The table names the solver and its status.
            warnings.simplefilter("ignore", UnconfirmedWarning)
            certificate = certified(gain, model, objective=_objective(objective), solver=solver)
    except UfirextError as error:
        typer.echo(f"ufirext certify: {error}", err=True)
        raise typer.Exit(2) from error
    _show(Console(), gain, certificate)
    if not certificate.confirmed:
        raise typer.Exit(1)


def _objective(text: str) -> str | int:
    return int(text) if text.isdecimal() else text


def _show(console: Console, gain: Gain | FMSGain, certificate: Certificate) -> None:
    table = Table(title=Text(repr(gain)), title_justify="left", box=None, pad_edge=False, show_header=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for name, text in _lines(certificate):
        table.add_row(Text(name), Text(text))
    console.print(table)


def _lines(certificate: Certificate) -> list[tuple[str, str]]:
    c = certificate
    verdict = "optimal" if c.optimal else "NOT optimal"
    lines = [
        ("verdict", f"{verdict}, {'confirmed' if c.confirmed else 'NOT confirmed'} by {c.solver}"),
        ("criterion", _CRITERIA[c.criterion]),
        ("feasibility", f"{c.feasibility:.1e} (bias; below {LIMIT:.0e})"),
        ("gap", f"{c.gap:.1e} standard deviations from the optimum (below {LIMIT:.0e})"),
        ("stationarity", f"{c.stationarity:.1e} (Karush-Kuhn-Tucker; below {LIMIT:.0e})"),
        ("duality", f"{c.duality:.1e} (below {LIMIT:.0e})"),
        ("objective", c.objective),
        ("value", f"{c.value:.12g}, solver {c.optimum:.12g}"),
        ("solver", f"{c.solver}: {c.status}, {c.seconds:.3f} s"),
        ("gain", f"differs from the solver's by {c.gain_difference:.1e} (below {SOLVER_LIMIT:.0e})"),
        ("literal problem", f"{c.literal_status}"),
    ]
    if c.literal_difference == c.literal_difference:
        lines[-1] = ("literal problem", f"{c.literal_status}, gain differs by {c.literal_difference:.1e}")
    return lines
