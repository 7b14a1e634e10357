"""Port of a supply that speaks SCPI: polled like one with a register for each value."""

from __future__ import annotations

from collections.abc import Callable

from adaptdrive.config.scpi import ScpiBus
from adaptdrive.config.timing import Timing
from adaptdrive.hardware.polled.link import PolledLink
from adaptdrive.hardware.polled.mapping import Poll
from adaptdrive.hardware.polled.port import PolledPort
from adaptdrive.hardware.scpi.link import ScpiConnection, describe_supply


class ScpiPort(PolledPort):
    """One connection to one supply."""

    def __init__(
        self, supply: ScpiBus, poll: Poll, timing: Timing, clock: Callable[[], float]
    ) -> None:
        """Prepare a port; nothing is opened yet.

        Args:
            supply: `[bus]`.
            poll: Its values as registers.
            timing: Times of the drive.
            clock: Monotonic clock, in s.
        """
        super().__init__(describe_supply(supply), supply.as_registers(), poll, timing, clock)
        self._supply = supply
        self._replies: dict[str, str] = {}

    def details(self) -> list[str]:
        """The last reply to each question, and what was refused."""
        refused = [line for line in super().details() if line.startswith("refused")]
        return [*(f"{question} {reply}" for question, reply in self._replies.items()), *refused]

    async def _read(self, link: PolledLink) -> None:
        """Read every value, and name the reply that is refused."""
        await super()._read(link)
        refused = self._failure.partition(":")[0]
        for source in (one for _, sources in self._poll.reads for one in sources):
            if source.quantity == refused:
                question = self._supply.values[source.item.name].query or ""
                reply = self._replies[question]
                self._failure = f"{refused}: {question} gives {reply!r}, no number in its range"

    def _new_link(self) -> PolledLink:
        return ScpiConnection(self._supply, self._counts, self._clock, self._replies)
