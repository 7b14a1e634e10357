"""Script of a demonstration, in half waves.

Each act comes shortly before a step of the reference, when the speed has settled, so that the
step shows what the act has changed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count

from adaptdrive_sim.demo.settings import ModeChoice

BEGINNING = "One disk turns. The fixed controller was designed for it and follows well."


@dataclass(frozen=True, slots=True)
class Act:
    """One act.

    Attributes:
        half: Half wave near whose end it comes, counted from 0.
        disks: Disks that are then on the shaft.
        mode: The controller to ask for; None to leave it.
        caption: What to look at, in words.
    """

    half: int
    disks: int
    mode: str | None
    caption: str


_ROUND = (
    Act(0, 2, None, "A second disk has dropped: twice the inertia, and the same fixed controller."),
    Act(1, 3, None, "A third disk. Watch how far the fixed controller now overshoots."),
    Act(3, 3, "adaptive", "Adaptive from here: it has learned the load and retuned itself."),
    Act(5, 1, None, "Two disks are off again. The estimates need some seconds to follow."),
    Act(6, 2, None, "A second disk has dropped, with the adaptive controller in force."),
    Act(7, 3, None, "A third disk, still adaptive. Compare the overshoots."),
    Act(9, 1, "fixed", "Back to one disk and to the fixed controller: the story begins again."),
)
_HALVES = 10


def acts(mode: ModeChoice, *, disks: bool) -> Iterator[Act]:
    """All acts, one round after the other, for ever.

    Args:
        mode: `alternate` for both controllers in turn, otherwise the mode is left alone.
        disks: Whether disks are dropped.
    """
    if mode == "alternate" or disks:
        for number in count():
            for act in _ROUND:
                yield _cast(act, number * _HALVES, mode, disks=disks)


def _cast(act: Act, offset: int, mode: ModeChoice, *, disks: bool) -> Act:
    """Return an act as this demonstration plays it."""
    alternating = mode == "alternate"
    number = act.disks if disks else 1
    asked = act.mode if alternating else None
    caption = act.caption if alternating and disks else _plain_caption(number, asked)
    return Act(act.half + offset, number, asked, caption)


def _plain_caption(disks: int, mode: str | None) -> str:
    number = f"{disks} disk{'s' if disks > 1 else ''} on the shaft."
    return f"{number} The {mode} controller was asked for." if mode else number
