"""S1, Figs 6 and 7: error against a wrong scale of the noise, with and without time stamps."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ufirext import Model
from validation.claims import AtLeast, Claim, Interval, absolute, relative, sampling
from validation.figures import INK, ORANGE, PURPLE, SKY, STYLES, new_figure
from validation.item import Item, Outcome, Table
from validation.papers import S1
from validation.s1.figs_2_to_5 import ASSUMED, OPEN, PARAMETERS
from validation.s1.filters import PRINTED, SUITED, Group, groups, tracked, truths, ufir, windowed
from validation.scores import Score, ratio, rmse, squares
from validation.study import Study
from validation.vehicle import misjudged

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["PICTURES"]

Array = NDArray[np.float64]

BETAS = np.geomspace(0.1, 10.0, 13)
DRIVES, OBEYING = "city drives", "tracks that obey the printed Q"


def at_beta(beta: float, found: list[Group], network: int, model: Model) -> Array:
    """Mean squared errors of the KF's runs."""
    return squares(tracked(found, network, model, beta), truths(found))


def run(study: Study, network: int) -> Outcome:
    """Sweep beta on drives, for the printed Q and one that suits them, and on tracks that obey it."""
    found = {DRIVES: groups(study, network), OBEYING: groups(study, network, obeying=True)}
    sweeps = {
        f"KF, σ_w = 0.2, {DRIVES}": study.sweep(at_beta, BETAS, found[DRIVES], network, PRINTED),
        f"KF, σ_w = 2, {DRIVES}": study.sweep(at_beta, BETAS, found[DRIVES], network, SUITED),
        f"KF, σ_w = 0.2, {OBEYING}": study.sweep(at_beta, BETAS, found[OBEYING], network, PRINTED),
    }
    flat = {
        f"UFIR, {name}": squares(windowed(study, some, network), truths(some)) for name, some in found.items()
    }
    printed, suited, obeying = sweeps.values()
    spread = ratio(max(suited, key=np.mean), min(suited, key=np.mean))
    item = study.item
    corners = (
        "a KF is best with the Q that suits the track: the printed one is far too small for corners, and "
        "small beta, which means Q / beta^2 and beta^2 R, makes up for it"
    )
    # The curves are flat at their minimum and the grid has steps of 47 %.
    step = relative(0.5)
    claims = [
        Claim("s1", item, "largest to least error of the KF over beta", AtLeast(1.2, "the KF is influenced"),
              spread.value, sampling(2), spread.error),
        Claim("s1", item, "UFIR, change of its estimates by beta", 0.0, _change(found[DRIVES][0], network),
              absolute(1e-9), unit="m"),
        Claim("s1", item, "beta of the least error, printed Q, tracks that obey it", 1.0, _best(obeying),
              step),
        Claim("s1", item, "beta of the least error, sigma_w = 2, drives", 1.0, _best(suited), step),
        Claim("s1", item, "beta of the least error, printed Q, drives", 1.0, _best(printed), step,
              because=corners, expected=Interval(0.2, 0.5)),
    ]  # fmt: skip
    scores = {name: [rmse(one) for one in sweep] for name, sweep in sweeps.items()}
    scores |= {name: [rmse(one)] * len(BETAS) for name, one in flat.items()}
    shown = range(0, len(BETAS), 2)
    rows = [[f"{BETAS[i]:.2g}", *(str(row[i]) for row in scores.values())] for i in shown]
    title = f"y-RMSE, m, over {len(truths(found[DRIVES]))} runs with network ({network})"
    return Outcome(claims, [Table(title, ("β", *scores), rows)], partial(draw, scores))


def _best(sweep: list[Array]) -> float:
    return float(BETAS[int(np.argmin([one.mean() for one in sweep]))])


def _change(group: Group, network: int) -> float:
    """What a wrong Q and R do to UFIR: one run with them, one without."""
    right = ufir(group.zs[0], group, network)
    wrong = ufir(group.zs[0], group, network, model=misjudged(PRINTED, 10.0))
    return float(np.nanmax(np.abs(right - wrong)))


def draw(scores: dict[str, list[Score]]) -> Figure:
    """y-RMSE against beta."""
    figure = new_figure(8.5, 5.0)
    axes = figure.subplots()
    looks: tuple[dict[str, Any], ...] = (
        {"color": ORANGE, "linestyle": "-."}, STYLES["KF"], {"color": PURPLE, "linestyle": "--"},
        STYLES["UFIR"], {"color": SKY, "linestyle": "-"},
    )  # fmt: skip
    for (name, row), look in zip(scores.items(), looks, strict=True):
        axes.plot(BETAS, [score.value for score in row], marker=".", label=name, **look)
    axes.axvline(1.0, color=INK, lw=0.8, ls=":")
    axes.set(xlabel="β", ylabel="y-RMSE, m", xscale="log", ylim=(0.0, 20.0))
    axes.set_xticks([0.1, 0.2, 0.5, 1, 2, 5, 10], ["0.1", "0.2", "0.5", "1", "2", "5", "10"])
    axes.legend(loc="upper left")
    return figure


def _item(number: int, network: int, words: str) -> Item:
    return Item(
        id=f"s1-fig-{number}",
        paper=S1,
        title=f"Fig. {number}: RMSE with Q / β² and β² R, {words}, model ({network})",
        run=partial(run, network=network),
        claims=(
            "largest to least error of the KF over beta",
            "UFIR, change of its estimates by beta",
            "beta of the least error, printed Q, tracks that obey it",
            "beta of the least error, sigma_w = 2, drives",
            "beta of the least error, printed Q, drives",
        ),
        parameters=PARAMETERS | {"β": "0.1 to 10, α = 1/β"},
        open_questions=OPEN,
        assumptions=[*ASSUMED, "A second set of tracks is drawn from the model with the printed Q."],
    )


PICTURES = (_item(6, 3, "time stamps"), _item(7, 5, "no time stamps"))
