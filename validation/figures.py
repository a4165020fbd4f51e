"""What all pictures share: colours that colour-blind readers tell apart, on light and on dark pages."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO, StringIO
from typing import TYPE_CHECKING, Any

import matplotlib as mpl

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "BLUE",
    "GREEN",
    "INK",
    "ORANGE",
    "PURPLE",
    "RED",
    "SKY",
    "STYLES",
    "new_figure",
    "png",
    "style",
    "svg",
]

# Okabe and Ito's palette without its black and its yellow, each legible on white and on near black.
ORANGE, SKY, GREEN, BLUE, RED, PURPLE = "#E69F00", "#56B4E9", "#009E73", "#0F7FC4", "#D55E00", "#CC79A7"
INK = "#5A5B5C"
"""Truth, axes and letters: the page's own text colour in the report."""

STYLES = {
    "UFIR": {"color": BLUE, "linestyle": "-"},
    "KF": {"color": RED, "linestyle": "--"},
    "H-inf": {"color": GREEN, "linestyle": "-."},
    "FMS filter": {"color": BLUE, "linestyle": "-"},
    "FMS smoother": {"color": ORANGE, "linestyle": "-"},
    "truth": {"color": INK, "linestyle": ":"},
}
"""How the contenders look in every picture."""


@contextmanager
def style() -> Iterator[None]:
    """Transparent background, one ink, thin grid."""
    ink = ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color")
    settings: Any = dict.fromkeys(ink, INK) | {
        "figure.facecolor": "none",
        "axes.facecolor": "none",
        "savefig.facecolor": "none",
        "legend.frameon": False,
        "legend.fontsize": 9,
        "axes.grid": True,
        "grid.alpha": 0.25,
        "grid.color": INK,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "lines.linewidth": 1.3,
        "font.size": 10,
        "svg.hashsalt": "ufirext",
        "path.simplify_threshold": 0.5,
    }
    with mpl.rc_context(settings):
        yield


def new_figure(width: float = 8.5, height: float = 4.5) -> Figure:
    """An empty figure, inches; pyplot is not involved."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def svg(figure: Figure) -> str:
    """The picture as text for a page: it takes the page's colour for its ink."""
    out = StringIO()
    figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    text = out.getvalue()
    return text[text.index("<svg") :].replace(INK.lower(), "currentColor")


def png(figure: Figure) -> bytes:
    """The picture as a file of its own, on white."""
    out = BytesIO()
    figure.savefig(out, format="png", dpi=130, facecolor="white")
    return out.getvalue()
