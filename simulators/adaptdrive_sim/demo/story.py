"""What a demonstration in virtual time is made of."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

from adaptdrive_sim.demo.play import Play
from adaptdrive_sim.demo.subject import Figures


@dataclass(frozen=True, slots=True)
class Scene:
    """One turn of a story.

    Attributes:
        time_s: When it comes, since the drive was enabled.
        caption: What to look at, for people.
        do: What is done to drive or load.
    """

    time_s: float
    caption: str
    do: Callable[[], None]


class Story(Protocol):
    """A load, what happens to it, and how to tell of it.

    Attributes:
        name: Name of the demonstration.
        title: What the plot shows.
        window_s: Longest time that the plot shows.
        play: The drive.
    """

    name: str
    title: str
    window_s: float
    play: Play

    def scenes(self) -> Iterator[Scene]:
        """What happens, in the order of time; the first is the beginning."""

    def watch(self) -> None:
        """Look at the load, once in every slow period."""

    @property
    def figures(self) -> Figures:
        """Tables for the live view."""

    def ended(self) -> bool:
        """Whether there is nothing more to see."""

    def summary(self) -> dict[str, Any]:
        """What is worth knowing at the end, apart from what all demonstrations have."""

    def problems(self) -> Iterator[str]:
        """What went wrong."""
