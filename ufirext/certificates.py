"""Certificates that a gain is the best unbiased one: figures anyone can recompute, and a convex solver."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from ._arrays import Array, covariance, one_of, readonly, real
from .errors import ShapeError, UfirextError, UnobservableWindow
from .fms import FMSGain, fms_window
from .gains import Gain
from .joint import require_definite
from .minimum_variance import MinimumVarianceGain
from .model import Model, require_model
from .programs import Objective, Solution, literal_program, objective_program, universal_program
from .regression import Regression, figures, row_sizes
from .window import Window, model_window

__all__ = ["Certificate", "UnconfirmedWarning", "certify"]

# Figures above this refuse a gain; a correct one leaves about 1e-12, an entry wrong by 1e-6 more than 1e-7.
LIMIT = 1e-8
# A solver's gain (value) may differ by this much before it does not confirm.
SOLVER_LIMIT = 1e-6


class UnconfirmedWarning(UserWarning):
    """A solver failed or did not reach its precision, so that it does not confirm the certificate.

    Examples
    --------
    OSQP does not handle the largest eigenvalue. What is optimal is so without its consent:

    >>> import warnings
    >>> from ufirext import UnconfirmedWarning, certify, kinematic, ufir_gain
    >>> model = kinematic(1, 1, 1.0)
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always", UnconfirmedWarning)
    ...     certificate = certify(ufir_gain(model, 8), model, objective="lambda_max", solver="OSQP")
    >>> certificate.optimal, certificate.confirmed, caught[0].category.__name__
    (True, False, 'UnconfirmedWarning')
    """


@dataclass(frozen=True, repr=False)
class Certificate:
    """Whether a gain is optimal, and the evidence.

    The first four figures need no solver; each is the worst over the rows of the gain and is zero for the
    optimal gain in exact arithmetic.

    Attributes
    ----------
    optimal : bool
        Feasibility, gap, stationarity and duality are all below 1e-8. No solver has a say in it.
    confirmed : bool
        `optimal`, and every solver reached its precision and the same gain and value within 1e-6.
    feasibility : float
        ``max |(H O - T) R1^-1| / |H|``: how far from unbiased.
    gap : float
        Square root of the excess of the variance over its optimum, relative: the distance from the optimal
        estimate, in standard deviations of its error.
    stationarity : float
        ``|(H S - D) Q2| / |H S|``: the Karush-Kuhn-Tucker residual.
    duality : float
        (primal - dual) / primal.
    primal, dual : ndarray, (rows,)
        Error variances of the gain, and lower bounds that no unbiased gain goes below.
    gain_difference, literal_difference : float
        Largest difference of a row to the gain of the solver for the universal and for the paper's literal
        problem, relative; NaN where the solver returned none or the problem was not posed.
    objective : str
        What the solver minimised, and of which states; P is under `criterion`.
    value, optimum : float
        The objective at the gain and at the solver's optimum.
    criterion : {"variance", "noise"}
        Error variance, or the noise of the measurements alone (the criterion of the unbiased FIR gain).
    solver, status, literal_status : str
        Name and verdicts, in the words of cvxpy.
    seconds : float
        Time in the solver.

    Examples
    --------
    >>> from ufirext import certify, fms_gain
    >>> certificate = certify(fms_gain(A=1, C=1, Q=1, R=1, M=5, d=2))
    >>> certificate.optimal, certificate.status
    (True, 'optimal')
    """

    optimal: bool
    confirmed: bool
    feasibility: float
    gap: float
    stationarity: float
    duality: float
    primal: Array
    dual: Array
    gain_difference: float
    literal_difference: float
    objective: str
    value: float
    optimum: float
    criterion: Literal["variance", "noise"]
    solver: str
    status: str
    literal_status: str
    seconds: float

    def __repr__(self) -> str:
        verdict = "optimal" if self.optimal else "NOT optimal"
        witness = "confirmed" if self.confirmed else "not confirmed"
        return (
            f"Certificate({verdict}: feasibility {self.feasibility:.1e}, gap {self.gap:.1e}, "
            f"stationarity {self.stationarity:.1e}, duality {self.duality:.1e}; {witness} by {self.solver}: "
            f"{self.status}, {self.objective} {self.optimum:.9g} against {self.value:.9g}, "
            f"{self.seconds:.3f} s)"
        )


def certify(
    gain: Gain | MinimumVarianceGain | FMSGain,
    model: Model | None = None,
    *,
    objective: str | int | ArrayLike = "trace",
    criterion: Literal["variance", "noise"] | None = None,
    solver: str = "CLARABEL",
) -> Certificate:
    """Certify that a gain is the best unbiased one of its window under a model.

    With the window as Z = O x + N e, x_aim = T x + E e, cov e = I, solves min ||E - H N||_F^2 subject to
    H O = T, equation :eq:`certificate`, and, where the transitions can be inverted, the problem of Kim
    (2019), (11) and (12), min tr(H Pi H') subject to H Gamma = I, equation :eq:`literal-certificate`; Pi is
    never inverted. Optimality is decided without the solver.

    Parameters
    ----------
    gain : FMSGain, MinimumVarianceGain or Gain
    model : Model
        The model to certify the gain for. May be left out for an `FMSGain`, which carries its own.
    objective : {"trace", "lambda_max"}, int or array_like (rows, rows), optional
        What to minimise: the sum of the error variances; their largest over all directions; the variance of
        one row of the gain; or trace(W P) for weights W, (rows,) or (rows, rows). By the theorem of Gauss and
        Markov one gain is optimal for all of them. A pair has the rows of x_now first, then those of x_lag.
    criterion : {"variance", "noise"}, optional
        "noise" leaves the process noise out: the criterion of `ufir_gain` (min ||K||_F for R = r I) and the
        default for its gains; "variance" is the default for all others.
    solver : str, optional
        Any solver of cvxpy that handles the problem: CLARABEL, OSQP, SCS, ...

    Returns
    -------
    Certificate

    Raises
    ------
    UfirextError
        If the solver is not installed, or the objective or the criterion is unknown.
    ShapeError
        If gain and model do not fit.
    UnobservableWindow
        If the window does not determine the state, so that no gain is unbiased.

    Warns
    -----
    UnconfirmedWarning
        If the solver fails or says that its solution is inaccurate.

    Examples
    --------
    >>> from ufirext import certify, kinematic, ufir_gain
    >>> model = kinematic(1, 1, 1.0)
    >>> certify(ufir_gain(model, 8), model).optimal
    True
    >>> certify(ufir_gain(model, 8), model, criterion="variance").optimal
    False
    """
    if criterion is None:
        criterion = "variance" if isinstance(gain, MinimumVarianceGain | FMSGain) else "noise"
    one_of(criterion, ("variance", "noise"), "criterion")
    H, window, aims = _posed(gain, model)
    problem = Regression.of(window, list(aims.values()), noise=criterion == "variance")
    H = H @ block_diag(*[np.linalg.inv(W) for W in window.W])
    name, weight = _objective(objective, list(aims), len(H))
    feasibility, gap, stationarity, primal, dual = figures(problem, H)
    duality = float((np.abs(primal - dual) / np.where(primal > 0.0, primal, 1.0)).max())
    optimal = all(figure < LIMIT for figure in (feasibility, gap, stationarity, duality))

    universal = universal_program(problem, solver)
    literal = literal_program(problem, solver)
    solutions = [universal] if literal is None else [universal, literal]
    value, optimum = float(primal.sum()), universal.value
    if weight is not None:
        other = objective_program(problem, weight, solver)
        value, optimum = _value(problem.errors(H), weight), other.value
        solutions.append(other)
    differences = [_difference(H, solution) for solution in (universal, literal)]
    agree = [abs(value - optimum) <= SOLVER_LIMIT * value]
    agree += [
        d <= SOLVER_LIMIT for d, s in zip(differences, (universal, literal), strict=True) if s is not None
    ]
    return Certificate(
        optimal=optimal,
        confirmed=optimal and _all_solved(solutions) and all(agree),
        feasibility=feasibility,
        gap=gap,
        stationarity=stationarity,
        duality=duality,
        primal=readonly(primal),
        dual=readonly(dual),
        gain_difference=differences[0],
        literal_difference=differences[1],
        objective=name,
        value=value,
        optimum=optimum,
        criterion=criterion,
        solver=solver,
        status=solutions[-1].status if weight is not None else universal.status,
        literal_status="not posed: the transitions are singular" if literal is None else literal.status,
        seconds=sum(solution.seconds for solution in solutions),
    )


def _posed(gain: Gain | FMSGain, model: Model | None) -> tuple[Array, Window, dict[str, int]]:
    """The gain's rows, its window under `model`, and the states its rows are of, with their times."""
    if model is not None:
        require_model(model)
    if isinstance(gain, FMSGain):
        model = gain.model if model is None else model
        K, window = gain.H, fms_window(model, gain.M, gain.d)
        aims = {"x_now": gain.M, "x_lag": gain.M - gain.d}
    elif not isinstance(gain, Gain):
        raise UfirextError(f"gain must be one of the library's gains, got {type(gain).__name__}")
    elif model is None:
        raise UfirextError("model must be given with this gain, which does not carry one, got None")
    else:
        window = model_window(model, gain.horizon, gain.lag)
        K, aims = gain.K, {"x_lag" if gain.lag else "x_now": window.aim}
        if isinstance(gain, MinimumVarianceGain) and gain.lag:
            K, aims = np.concatenate([gain.K_now, gain.K]), {"x_now": gain.horizon - 1, **aims}
    require_definite(model.R)
    if K.shape != (wanted := (model.dim_x * len(aims), window.starts[-1])):
        raise ShapeError(f"gain must have shape {wanted} for this model and horizon, got {K.shape}")
    if not window.determined():
        raise UnobservableWindow(
            f"the window must determine the state, or no gain is unbiased; its rows have rank {window.rank}",
            rank=window.rank,
        )
    return K, window, aims


def _objective(objective: str | int | ArrayLike, of: list[str], rows: int) -> tuple[str, Objective | None]:
    """Its name, and "lambda_max", a weight matrix, or None for the trace."""
    P = f"P of {' and '.join(of)}"
    if isinstance(objective, str):
        if objective == "trace":
            return f"trace {P}", None
        if objective == "lambda_max":
            return f"lambda_max {P}", "lambda_max"
        raise UfirextError(f"objective must be 'trace', 'lambda_max', a row or weights, got {objective!r}")
    if isinstance(objective, int | np.integer):
        if not 0 <= objective < rows:
            raise UfirextError(
                f"objective must name one of the {rows} rows of the gain, 0 to {rows - 1}, got {objective}"
            )
        state, entry = divmod(int(objective), rows // len(of))
        return f"variance of {of[state]}[{entry}]", np.diag(np.arange(rows) == objective).astype(float)
    weights = real(objective, "objective")
    weights = np.diag(weights) if weights.ndim == 1 else weights
    return f"trace W {P}", covariance(weights, rows, "objective", "weights of the gain's rows")


def _value(error: Array, objective: Objective) -> float:
    P = error @ error.T
    return float(np.linalg.eigvalsh(P)[-1] if isinstance(objective, str) else np.trace(objective @ P))


def _difference(H: Array, solution: Solution | None) -> float:
    """Of the solver's gain, relative to each row."""
    if solution is None or solution.gain is None:
        return np.nan
    size = row_sizes(solution.gain)
    return float((row_sizes(H - solution.gain) / np.where(size > 0.0, size, 1.0)).max())


def _all_solved(solutions: list[Solution]) -> bool:
    bad = [
        f"{solution.solver} says {solution.status!r}"
        for solution in solutions
        if solution.status != "optimal"
    ]
    if bad:
        warnings.warn(
            f"the certificate is not confirmed: {'; '.join(bad)}; try another solver",
            UnconfirmedWarning,
            stacklevel=3,
        )
    return not bad
