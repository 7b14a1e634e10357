"""Mapping of registers to quantities, with as few exchanges per poll as possible.

Everything that can be wrong is found here, before a link is opened, and all of it at once.
"""

import functools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, TypeVar

from adaptdrive.config import Configuration, polled
from adaptdrive.config.bus import CommandSwitch
from adaptdrive.control.signals import Command
from adaptdrive.devices import binding, description
from adaptdrive.devices.description import Sink, Source
from adaptdrive.devices.field import Field
from adaptdrive.devices.polled import registers
from adaptdrive.safety.timing import timing_of
from adaptdrive.util.errors import ConfigurationError, Flaw

HEARTBEAT = "bus.heartbeat"
"""No name of a register, which has no dot."""

_MAX_WRITE = 121
"""Registers that function 23 can write (Modbus application protocol, 6.17)."""


Bound = TypeVar("Bound", Source["Named"], Sink["Named"])


class Named(NamedTuple):
    """A register and its name in the map."""

    name: str
    register: polled.Register


class RegisterCatalogue(binding.Catalogue[Named]):
    """Finds registers by name."""

    on = None

    def __init__(self, named: Mapping[str, polled.Register]) -> None:
        super().__init__()
        self._registers = named

    def find(self, reference: str, place: str) -> Named | None:  # noqa: ARG002 - none is missing
        """The register that a reference of a validated configuration names."""
        return Named(reference, self._registers[reference])

    def field(self, item: Named, use: binding.Use) -> Field:
        """Return how a register is coded."""
        return registers.register_field(item.name, item.register, use)

    def count_problem(self, item: Named) -> str | None:  # noqa: ARG002 - polls are counted by none
        """Return None: no tick is counted by a register."""
        return None

    def _switches(
        self, switch: CommandSwitch | None, name: str = binding.BRIDGE
    ) -> Iterator[Sink[Named]]:
        if switch is None or switch.off_signal is None or name != binding.BRIDGE:
            yield from super()._switches(switch, name)
            return
        place = "signals.command.bridge"
        if switch.on is not None or switch.off is not None:
            self.note(place, "with off_signal both coils are set to 1: leave on and off out")
        for coil, on in ((switch.signal, True), (switch.off_signal, False)):
            item = Named(coil, self._registers[coil])
            if item.register.table != "coil":
                self.note(place, f"{coil!r} is no coil, which off_signal needs")
            field = self.field(item, "command")
            yield Sink(binding.BRIDGE, item, field, float(not on), 2.0 * on - 1.0, only=on)


def value_in(source: Source[Named], block: registers.Block, words: list[int]) -> float | None:
    """Return a quantity from the registers of its block, None when it must not be used."""
    taken = _words(source, block, words)
    value = registers.decode(source.item.register, source.field, taken)
    if value is None:
        return None
    if source.on is not None:
        value = float(value == source.on)
    if not value and registers.count(source.item.register, taken) in source.field.blanks:
        return None  # it only reads as off
    return value * source.scale + source.offset


def explain(source: Source[Named], block: registers.Block, words: list[int]) -> str:
    """Return why a quantity must not be used: its name, its place and what is there."""
    register, taken = source.item.register, _words(source, block, words)
    block = registers.Block(register.table, register.address, register.words)
    refused = registers.refusal(register, source.field, taken)
    return f"{source.quantity}: {block} {refused}"


def _words(source: Source[Named], block: registers.Block, words: list[int]) -> list[int]:
    register = source.item.register
    start = register.address - block.address
    return words[start : start + register.words]


def block_words(
    block: registers.Block, sinks: Iterable[Sink[Named]], command: Command, heartbeat: int
) -> list[int]:
    """Return the registers of a block; fields of one register are put together.

    Raises:
        ValueError: They cannot hold their part of the command.
    """
    words = [0] * block.count
    for sink in sinks:
        first = sink.item.register.address - block.address
        for number, word in enumerate(written(sink, command, heartbeat), first):
            words[number] |= word
    return words


def written(sink: Sink[Named], command: Command, heartbeat: int) -> list[int]:
    """Return the registers of a part of a command, or of the daemon's heartbeat.

    Raises:
        ValueError: They cannot hold it.
    """
    register = sink.item.register
    if sink.name == HEARTBEAT:  # a signed register stays positive
        bits = 16 * register.words - register.type.startswith("int")
        return registers.encode_count(register, heartbeat % (1 << bits))
    return registers.encode_count(register, sink.field.raw(sink.value(command)))


@dataclass(frozen=True, slots=True)
class Poll:
    """Exchanges with the drive in one poll cycle.

    Attributes:
        sources: Where each quantity comes from.
        reads: Blocks to read, and what is taken from each.
        writes: Blocks to write, and what goes into each.
        combined: Whether the only write travels with the first read.
        interval_s: Longest time between two writes of the same registers, 0 for each poll.
        setup: What is written before the drive is commanded, whether it reads as written.
    """

    sources: tuple[Source[Named], ...]
    reads: tuple[tuple[registers.Block, tuple[Source[Named], ...]], ...]
    writes: tuple[tuple[registers.Block, tuple[Sink[Named], ...]], ...]
    combined: bool
    interval_s: float = 0.0
    setup: tuple[tuple[registers.Block, Sink[Named], bool], ...] = ()

    @property
    def bridge_block(self) -> registers.Block | None:
        """The block with the report of the bridge, None for a drive without one."""
        return next((read[0] for read in self.reads if _has_bridge(read)), None)

    @property
    def bridge_last(self) -> tuple[tuple[registers.Block, tuple[Source[Named], ...]], ...]:
        """The reads, that of the bridge last: a command follows the newest report."""
        return tuple(sorted(self.reads, key=_has_bridge))

    def exchanges(self) -> Iterator[registers.Exchange]:
        """Every exchange of a poll in which a new command goes out."""
        for number, (block, _) in enumerate(self.reads):
            together = self.combined and number == 0
            yield registers.Exchange(read=block, write=self.writes[0][0] if together else None)
        for block, _ in self.writes:
            yield registers.Exchange(write=block)


def _has_bridge(block: tuple[registers.Block, tuple[Source[Named], ...]]) -> bool:
    return any(source.quantity == binding.BRIDGE for source in block[1])


def map_drive(
    configuration: Configuration, bus: polled.ModbusBus, source: Path | str, *, passive: bool
) -> Poll:
    """Plan the polls of a drive.

    Args:
        configuration: The drive.
        bus: `[bus]`, with a register for each value.
        source: The configuration's file, for error messages.
        passive: Whether nothing may be written to the drive.

    Raises:
        ConfigurationError: Something does not fit; every flaw is listed.
    """
    signals, demands = configuration.signals, description.demands_of(configuration)
    catalogue = RegisterCatalogue(bus.registers)
    bound = catalogue.sources(signals.entries(), demands)
    sources, sinks = [*bound], catalogue.sinks(signals.command, demands)
    setup = catalogue.settings(bus.setup, "bus.setup", "setup")
    if bus.heartbeat.drive is not None:
        beat = Named(bus.heartbeat.drive, bus.registers[bus.heartbeat.drive])
        field = catalogue.field(beat, "word")
        sources.append(Source(HEARTBEAT, beat, field, 1.0, 0.0, None, "bus.heartbeat.drive"))
    if bus.heartbeat.daemon is not None:
        beat = Named(bus.heartbeat.daemon, bus.registers[bus.heartbeat.daemon])
        sinks.append(Sink(HEARTBEAT, beat, catalogue.field(beat, "command"), 0.0, 1.0))
    measured = (one.item.register for one in sources)
    reads = registers.plan_blocks(measured, bus.max_gap, bus.max_block)
    # function 23 takes holding registers only, and takes its write before its read
    reads = tuple(sorted(reads, key=lambda block: block.table != "holding"))
    longest = 1 if bus.write == "single" else _MAX_WRITE
    plan = functools.partial(registers.plan_blocks, max_gap=0, max_count=longest, write=True)
    written_to = [one.item.register for one in sinks]
    limited = [one for one in written_to if one.write_limit is not None]
    writes = *plan(one for one in written_to if one.write_limit is None), *plan(limited)
    poll = Poll(
        sources=tuple(bound),
        reads=tuple((block, inside(block, sources)) for block in reads),
        writes=tuple((block, inside(block, sinks)) for block in writes),
        combined=bus.write == "with-read",
        interval_s=bus.command_interval_s,
        setup=tuple(
            (block, one, one.name not in bus.setup_unread)
            for one in setup
            for block in plan([one.item.register])
        ),
    )
    flaws = [*catalogue.flaws, *_combined_flaws(bus, reads, writes)]
    if not flaws:
        half_cycle_s = timing_of(configuration).half_cycle_s
        wanted = (bus.poll_ticks * half_cycle_s, "bus.poll_ticks", half_cycle_s)
        flaws += registers.cycle_flaws(bus, [*poll.exchanges()], *wanted)
    if flaws:
        raise ConfigurationError(source, flaws)
    return replace(poll, setup=()) if passive else poll  # without a command, nothing is written


def inside(block: registers.Block, bound: Iterable[Bound]) -> tuple[Bound, ...]:
    """Return what is taken from a block, or goes into it."""
    return tuple(one for one in bound if block.holds(one.item.register))


def _combined_flaws(
    bus: polled.ModbusBus, reads: tuple[registers.Block, ...], writes: tuple[registers.Block, ...]
) -> Iterator[Flaw]:
    alone = [block for block in writes if bus.write == "single" and block.count > 1]
    for block in alone:
        yield Flaw("bus.write", f"'single' writes one register, and one value takes {block}")
    if bus.write != "with-read":
        return
    if len(writes) != 1:
        yield Flaw("bus.write", f"'with-read': the command must be one block, it is {len(writes)}")
    if not reads or reads[0].table != "holding":
        problem = "'with-read': function 23 reads holding registers, and none is measured"
        yield Flaw("bus.write", problem)
