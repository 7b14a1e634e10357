"""Port of a supply that speaks SCPI: polled like one with a register for each value."""

from __future__ import annotations

from collections.abc import Callable

from adaptdrive.config.scpi import ScpiBus
from adaptdrive.config.timing import Timing
from adaptdrive.hardware.modbus.link import PolledLink
from adaptdrive.hardware.modbus.mapping import Poll
from adaptdrive.hardware.modbus.port import ModbusPort
from adaptdrive.hardware.scpi.link import ScpiConnection, describe_supply


class ScpiPort(ModbusPort):
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
        super().__init__(supply.as_registers(), poll, timing, clock)
        self._supply = supply
        self._replies: dict[str, str] = {}

    @property
    def description(self) -> str:
        """The bus in one phrase, such as `scpi 10.0.0.7:5025`."""
        return describe_supply(self._supply)

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

    async def _open(self) -> PolledLink:
        registers = self._config.registers
        link = ScpiConnection(self._supply, registers, self._counts, self._clock, self._replies)
        await link.open()
        return link
