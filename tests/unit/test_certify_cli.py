"""`ufirext certify FILE` reads models, judges gains, and says why it cannot."""

from __future__ import annotations

import json

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from tests.theory.test_fms_gain import QW, A, C, G, R, tracking
from ufirext import kinematic, minimum_variance_gain, ufir_gain
from ufirext.certify_cli import certify

TOML = """
A = [[1, 2, 2], [0, 1, 2], [0, 0, 1]]
C = [[1, 0, 0]]
G = [[1, 0], [1, 0], [0, 1]]
Q = [[0.029929, 0], [0, 1e-4]]
R = 0.0025
M = 15
d = 5
"""


def run(*arguments: object):
    app = typer.Typer()
    app.command()(certify)
    return CliRunner().invoke(app, [str(argument) for argument in arguments], env={"COLUMNS": "120"})


def written(path, said):
    path.write_text(said if isinstance(said, str) else json.dumps(said), encoding="utf-8")
    return path


def ours(**more):
    model = kinematic(1, 1, 1.0)
    said = {
        "F": model.F.tolist(),
        "H": model.H.tolist(),
        "Q": model.Q.tolist(),
        "R": model.R.tolist(),
        "horizon": 6,
    }
    return {**said, **more}


def papers(**more):
    said = {
        "A": A.tolist(),
        "C": C.tolist(),
        "Q": QW.tolist(),
        "R": R.tolist(),
        "G": G.tolist(),
        "M": 15,
        "d": 5,
    }
    return {**said, **more}


def test_a_toml_file_in_the_paper_s_letters(tmp_path):
    result = run(written(tmp_path / "tracking.toml", TOML))
    assert result.exit_code == 0
    assert "FMSGain(M=15, d=5, n=3, q=1)" in result.output
    assert "optimal, confirmed by CLARABEL" in result.output
    assert f"{np.trace(tracking().P):.11g}"[:-1] in result.output


@pytest.mark.parametrize("more", [{}, {"lag": 2}, {"kind": "ufir"}, {"kind": "ufir", "lag": 3}])
def test_a_json_file_in_our_letters(tmp_path, more):
    result = run(written(tmp_path / "model.json", ours(**more)))
    assert result.exit_code == 0
    assert "optimal, confirmed" in result.output


def shown(output):
    """Heading -> text, of the lines of the table."""
    lines = [line.split(maxsplit=1) for line in output.splitlines()]
    return {line[0]: line[1].strip() for line in lines if len(line) == 2}


def test_every_number_says_whose_it_is(tmp_path):
    pair = minimum_variance_gain(kinematic(1, 1, 1.0), 6, 2)
    now, lagged = np.trace(pair.P_now), np.trace(pair.P)
    path = written(tmp_path / "pair.json", ours(lag=2))
    both = run(path).output
    assert f"x_now with trace P = {now:.6g} and x_lag with trace P = {lagged:.6g}" in " ".join(both.split())
    assert shown(both)["objective"] == "trace P of x_now and x_lag"
    assert float(shown(both)["value"].partition(",")[0]) == pytest.approx(now + lagged)
    for row, whose in enumerate(["x_now[0]", "x_now[1]", "x_lag[0]", "x_lag[1]"]):
        one = shown(run(path, "--objective", row).output)
        assert one["objective"] == f"variance of {whose}"
        variance = np.diag(pair.P_now if row < 2 else pair.P)[row % 2]
        assert float(one["value"].partition(",")[0]) == pytest.approx(variance)


@pytest.mark.parametrize(("lag", "whose"), [(0, "x_now"), (2, "x_lag")])
def test_the_trace_of_an_unbiased_gain_is_that_of_the_noise_it_passes(tmp_path, lag, whose):
    table = shown(run(written(tmp_path / "model.json", ours(kind="ufir", lag=lag))).output)
    passed = ufir_gain(kinematic(1, 1, 1.0), 6, lag).G
    assert table["objective"] == f"trace P of {whose}"
    assert table["criterion"].endswith("P without process noise")
    assert float(table["value"].partition(",")[0]) == pytest.approx(np.trace(passed))


def test_horizon_lag_and_objective_from_the_command_line(tmp_path):
    path = written(tmp_path / "tracking.toml", TOML)
    result = run(path, "--horizon", 9, "--lag", 0, "--objective", "lambda_max")
    assert result.exit_code == 0
    assert "FMSGain(M=9, d=0" in result.output
    assert "lambda_max P" in result.output
    assert run(path, "--objective", "3").exit_code == 0


@pytest.mark.parametrize("kind", ["ufir", "minimum variance"])
def test_a_gain_of_one_s_own_is_judged(tmp_path, kind):
    K = ufir_gain(kinematic(1, 1, 1.0), 6).K
    verdict = run(written(tmp_path / "own.json", ours(gain=K.tolist(), kind=kind)))
    assert verdict.exit_code == (0 if kind == "ufir" else 1)
    wrong = K.copy()
    wrong[0, 0] += 1e-6
    refused = run(written(tmp_path / "wrong.json", ours(gain=wrong.tolist(), kind=kind)))
    assert refused.exit_code == 1
    assert "NOT optimal, NOT confirmed" in refused.output


def test_a_wrong_gain_of_the_paper_s_kind_is_refused(tmp_path):
    H = tracking().H * 1.001
    assert run(written(tmp_path / "own.json", papers(gain=H.tolist()))).exit_code == 1


@pytest.mark.parametrize(
    ("name", "said", "message"),
    [
        ("model.yaml", "", "must end in .toml or .json"),
        ("model.toml", "A = ", "is not TOML"),
        ("model.json", "[1, 2]", "must hold named matrices, got list"),
        ("model.json", {"F": [[1]]}, "must say H, Q, R, horizon, which is missing"),
        (
            "model.json",
            ours(sigma=1.0),
            "keys must be among B, F, H, Q, R, gain, horizon, kind, lag, got sigma",
        ),
        ("model.json", ours(kind="best"), "kind must be 'minimum variance' or 'ufir', got 'best'"),
        ("model.json", ours(horizon=1), "the shortest horizon that works is 2"),
        ("model.json", ours(R=[[-1.0]]), "R must be positive semidefinite"),
        ("model.json", ours(gain=[[1.0]]), "gain must have shape (2, 6)"),
        ("model.json", papers(M=2, d=0), "the shortest M that works is 3"),
    ],
)
def test_what_is_wrong_is_said_on_one_line(tmp_path, name, said, message):
    result = run(written(tmp_path / name, said))
    assert result.exit_code == 2
    assert message in result.output
    assert "Traceback" not in result.output


def test_a_file_that_is_not_there_and_a_solver_that_is_not_installed(tmp_path):
    assert "cannot be read: No such file" in run(tmp_path / "none.toml").output
    result = run(written(tmp_path / "tracking.toml", TOML), "--solver", "NOSUCH")
    assert result.exit_code == 2
    assert "solver must be installed" in result.output


def test_a_solver_that_fails_is_named_and_does_not_confirm(tmp_path):
    result = run(written(tmp_path / "tracking.toml", TOML), "--solver", "OSQP", "--objective", "lambda_max")
    assert result.exit_code == 1
    assert "OSQP: failed" in result.output
