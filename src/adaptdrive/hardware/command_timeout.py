"""Comparison of a drive's own command time-out with the times in which it may get no command."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from adaptdrive.config.timing import Timing
from adaptdrive.errors import Flaw


@dataclass(frozen=True, slots=True)
class CommandPause:
    """A time without a command that the daemon drives on after.

    Attributes:
        longest_s: The time, in s.
        meaning: What it is.
        key: Key that determines it.
    """

    longest_s: float
    meaning: str
    key: str


def lost_command(timing: Timing, key: str) -> CommandPause:
    """Return the pause where one command is lost, and the next one is late.

    Args:
        timing: Times of the drive; each reading has a command.
        key: Key that determines it.
    """
    meaning = (
        f"two and a half times the {timing.reading_s * 1e3:.4g} ms from one command to the next"
    )
    return CommandPause(timing.command_pause_s, meaning, key)


def silence(longest_s: float, key: str) -> CommandPause:
    """Return the pause where the drive or the daemon is silent, and the drive just not tripped.

    Args:
        longest_s: The time, in s.
        key: Key that determines it.
    """
    return CommandPause(longest_s, "the silence after which the daemon trips", key)


def timeout_cautions(timeout_s: float | None, *pauses: CommandPause) -> Iterator[Flaw]:
    """Yield one word on a time-out that is not stated, or ends before pauses of the daemon.

    Args:
        timeout_s: The drive's own time-out, in s, None where it is not known.
        pauses: The pauses.
    """
    if timeout_s is None:
        yield Flaw(
            "bus.command_timeout_s",
            "is left out: a drive without a time-out of its own stays energised when the daemon, "
            "its computer or the cable fails; state it, or wire a contactor for that",
        )
        return
    longer = [one for one in pauses if timeout_s <= one.longest_s]
    if not longer:
        return
    named = ", nor than ".join(f"{one.longest_s:.4g} s, {one.meaning}" for one in longer)
    keys = " and ".join(one.key for one in longer)
    yield Flaw(
        "bus.command_timeout_s",
        f"{timeout_s:g} s is not longer than {named}: the drive stops by itself before; set a "
        f"longer time-out in the drive, or lower {keys}",
    )
