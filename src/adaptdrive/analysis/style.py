"""Style of the figures: one typeface, few colours, no unnecessary frames."""

from contextlib import AbstractContextManager
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes

Look = dict[str, Any]

WIDTH_in = 7.16
"""Both columns of a journal page."""

DPI = 300

REFERENCE: Look = {"color": "0.62", "linewidth": 1.0}
FIXED: Look = {"color": "#b4472e", "linewidth": 0.9}
ADAPTIVE: Look = {"color": "#1d4e79", "linewidth": 0.9}
DIRECT: Look = {"color": "#c79a2b", "linewidth": 0.9}
TRUTH: Look = {"color": "0.25", "linewidth": 0.8, "linestyle": (0, (4, 2))}
PARAMETERS = ("#1d4e79", "#b4472e", "#4c8b57")

_STYLE: Any = {
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.labelsize": 9.0,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "legend.fontsize": 8.0,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlelocation": "left",
    "axes.titlepad": 4.0,
    "axes.axisbelow": True,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "legend.frameon": False,
    "legend.borderaxespad": 0.2,
    "legend.handlelength": 1.8,
    "legend.columnspacing": 1.4,
    "lines.solid_capstyle": "butt",
    "figure.constrained_layout.h_pad": 0.03,
    "figure.constrained_layout.w_pad": 0.03,
}


def journal() -> AbstractContextManager[None]:
    """Within this context figures look as they should."""
    return rc_context(_STYLE)


def letter(axes: Axes, name: str, title: str) -> None:
    """Name a panel."""
    axes.set_title(rf"$\mathbf{{({name})}}$  {title}")


def legend_above(axes: Axes, columns: int) -> None:
    """Put the legend next to the panel's title, where it hides no data."""
    axes.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=columns,
        borderpad=0.0,
        borderaxespad=0.1,
    )
