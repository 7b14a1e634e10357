"""Mapping of registers to quantities, with as few exchanges per poll as possible.

Everything that can be wrong is found here, before a link is opened, and all of it at once.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from adaptdrive.config.bus import Signals, SignalSource, SwitchSource
from adaptdrive.config.modbus import ModbusBus, Register
from adaptdrive.config.references import COMMANDED, MEASURED, WORDS
from adaptdrive.config.units import WANTED
from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.errors import ConfigurationError, Flaw
from adaptdrive.hardware.demands import NO_DEMANDS, Demands, is_whole
from adaptdrive.hardware.modbus.blocks import Block, plan_blocks
from adaptdrive.hardware.modbus.capacity import Exchange, capacity_flaws
from adaptdrive.hardware.modbus.codec import decode_value, encode_count, encode_value, refusal

HEARTBEAT = "heartbeat"
_BRIDGE = "bridge"
_MAX_WRITE = 121
"""Registers that function 23 can write (Modbus application protocol, 6.17)."""

_ALL_ONES = 0xFFFF
_COUNTS = (*WORDS, HEARTBEAT)


@dataclass(frozen=True, slots=True)
class RegisterSource:
    """Source of a quantity.

    Attributes:
        quantity: Field of `Reading`, or the drive's heartbeat.
        register: Register of the map.
        scale: SI units per unit of the register.
        offset: SI value of a zero register.
        on: Count of a switch that means on, None where any but 0 does.
    """

    quantity: str
    register: Register
    scale: float = 1.0
    offset: float = 0.0
    on: float | None = None

    def value(self, block: Block, words: list[int]) -> float | None:
        """The quantity from the registers of its block, None when it must not be used."""
        taken = self._words(block, words)
        value = decode_value(self.register, taken, measured=self.quantity not in _COUNTS)
        if value is None:
            return None
        if self.on is not None:
            value = float(value == self.on)
        if not value and self._is_blank(taken):
            return None
        return value * self.scale + self.offset

    def word(self, block: Block, words: list[int]) -> float | None:
        """The word beside values that are refused: all its bits set are no word there."""
        taken = self._words(block, words)
        blank = all(word == _ALL_ONES for word in taken)
        if blank or decode_value(self.register, taken, measured=True) is None:
            return None
        return self.value(block, words)

    def explain(self, block: Block, words: list[int]) -> str:
        """Return why the quantity must not be used: its name, its place and what is there."""
        register, taken = self.register, self._words(block, words)
        if self.quantity == _BRIDGE and self._is_unset(taken):
            found = f"holds {' '.join(f'{word:04x}' for word in taken)}, its word for no value"
        else:
            measured = self.quantity not in _COUNTS or self._is_blank(taken)
            found = refusal(register, taken, measured=measured)
        return f"{self.quantity}: {Block(register.table, register.address, register.words)} {found}"

    def _is_blank(self, taken: list[int]) -> bool:
        """Return whether a bridge holds its count for no value, which may read as off.

        Of a bit all bits of its word count, as 0x8000 is a word of which one is set.
        """
        if self.quantity != _BRIDGE:
            return False
        known = decode_value(self.register, taken, measured=True) is not None
        part = self.register.bit is not None and any(word != _ALL_ONES for word in taken)
        return self._is_unset(taken) or not (known or part)

    def _is_unset(self, taken: list[int]) -> bool:
        """Return whether all bits are set, as by a gateway for a module that it does not reach.

        In a signed register, too, where its map gives no other count for no value.
        """
        return self.register.not_available is None and all(word == _ALL_ONES for word in taken)

    def _words(self, block: Block, words: list[int]) -> list[int]:
        start = self.register.address - block.address
        return words[start : start + self.register.words]


@dataclass(frozen=True, slots=True)
class RegisterSink:
    """Destination of a part of the command: a field of `Command` or the daemon's heartbeat."""

    name: str
    register: Register
    scale: float = 1.0
    offset: float = 0.0

    def words(self, command: Command, heartbeat: int) -> list[int]:
        """The registers of its part of the command.

        Raises:
            ValueError: They cannot hold it.
        """
        if self.name == HEARTBEAT:
            return encode_count(self.register, heartbeat % heartbeat_modulus(self.register))
        if self.name == _BRIDGE:
            return encode_count(
                self.register, self.register.on if command.bridge else self.register.off
            )
        return encode_value(self.register, (getattr(command, self.name) - self.offset) / self.scale)

    @property
    def sent_for_zero(self) -> float:
        """Value that the drive takes for a commanded 0: that of the nearest count."""
        count = -self.offset / self.scale / self.register.scale
        exact = self.register.type == "float32" or is_whole(count)
        return 0.0 if exact else round(count) * self.register.scale * self.scale + self.offset


@dataclass(frozen=True, slots=True)
class Poll:
    """Exchanges with the drive in one poll cycle.

    Attributes:
        reads: Blocks to read, and what is taken from each.
        writes: Blocks to write, and what goes into each.
        combined: Whether the only write travels with the first read.
        other: Names of more values of the drive.
    """

    reads: tuple[tuple[Block, tuple[RegisterSource, ...]], ...]
    writes: tuple[tuple[Block, tuple[RegisterSink, ...]], ...]
    combined: bool
    other: tuple[str, ...] = ()

    @property
    def reports_bridge(self) -> bool:
        """True for a drive whose map has a register for its bridge."""
        return self.bridge_block is not None

    @property
    def bridge_block(self) -> Block | None:
        """The block with the report of the bridge, None for a drive without one."""
        return next((read[0] for read in self.reads if _has_bridge(read)), None)

    @property
    def bridge_last(self) -> tuple[tuple[Block, tuple[RegisterSource, ...]], ...]:
        """The reads, that of the bridge last: a command that follows knows the newest report."""
        return tuple(sorted(self.reads, key=_has_bridge))

    def exchanges(self) -> Iterator[Exchange]:
        """Every exchange of a poll in which a new command goes out."""
        for number, (block, _) in enumerate(self.reads):
            together = self.combined and number == 0
            yield Exchange(read=block, write=self.writes[0][0] if together else None)
        for block, _ in self.writes:
            yield Exchange(write=block)


def _has_bridge(block: tuple[Block, tuple[RegisterSource, ...]]) -> bool:
    return any(source.quantity == _BRIDGE for source in block[1])


def map_drive(
    bus: ModbusBus,
    signals: Signals,
    half_cycle_s: float,
    source: Path | str = "configuration",
    demands: Demands = NO_DEMANDS,
) -> Poll:
    """Plan the polls of a drive.

    Args:
        bus: `[bus]`; its references are those of a validated configuration.
        signals: `[signals]`.
        half_cycle_s: Half a line cycle.
        source: The configuration, for the error message.
        demands: What the registers must be able to carry.

    Raises:
        ConfigurationError: Something does not fit; every flaw is listed.
    """
    sources, sinks = list(_sources(bus, signals)), list(_sinks(bus, signals))
    reads = plan_blocks((one.register for one in sources), bus.max_gap, bus.max_block)
    # function 23 takes holding registers only, and takes its write before its read
    reads = tuple(sorted(reads, key=lambda block: block.table != "holding"))
    writes = plan_blocks((one.register for one in sinks), 0, _MAX_WRITE)
    poll = Poll(
        reads=tuple((block, tuple(_inside(block, sources))) for block in reads),
        writes=tuple((block, tuple(_within(block, sinks))) for block in writes),
        combined=bus.read_write,
        other=tuple(signals.other),
    )
    flaws = [
        *_command_flaws(sinks),
        *_demand_flaws(sinks, demands),
        *_combined_flaws(bus, reads, writes),
    ]
    flaws += [] if flaws else capacity_flaws(bus, poll.exchanges(), half_cycle_s)
    if flaws:
        raise ConfigurationError(source, flaws)
    return poll


def heartbeat_modulus(register: Register) -> int:
    """Return the modulus of a heartbeat: a signed register stays positive."""
    return 1 << (16 * register.words - register.type.startswith("int"))


def _sources(bus: ModbusBus, signals: Signals) -> Iterator[RegisterSource]:
    named = [(quantity, getattr(signals, quantity)) for quantity in (*MEASURED, *WORDS)]
    for quantity, given in (*named, *signals.other.items()):
        if given is not None:
            register = bus.registers[given.signal]
            on = given.on if isinstance(given, SwitchSource) else None
            count = None if on is None else float(on)
            yield RegisterSource(quantity, register, given.scale, given.offset, count)
    if bus.heartbeat.drive is not None:
        yield RegisterSource(HEARTBEAT, bus.registers[bus.heartbeat.drive])


def _sinks(bus: ModbusBus, signals: Signals) -> Iterator[RegisterSink]:
    for name in COMMANDED:
        given = getattr(signals.command, name)
        if given is not None:
            scaled = isinstance(given, SignalSource)
            conversion = (given.scale, given.offset) if scaled else ()
            yield RegisterSink(name, bus.registers[given.signal], *conversion)
    if bus.heartbeat.daemon is not None:
        yield RegisterSink(HEARTBEAT, bus.registers[bus.heartbeat.daemon])


def _inside(block: Block, sources: Iterable[RegisterSource]) -> Iterator[RegisterSource]:
    return (one for one in sources if block.holds(one.register))


def _within(block: Block, sinks: Iterable[RegisterSink]) -> Iterator[RegisterSink]:
    """In the order of the addresses: a write has no gaps."""
    inside = (one for one in sinks if block.holds(one.register))
    return iter(sorted(inside, key=lambda one: one.register.address))


def _command_flaws(sinks: Iterable[RegisterSink]) -> Iterator[Flaw]:
    """The safe command, and the bridge both ways, must fit into their registers."""
    for sink in sinks:
        place = f"signals.command.{sink.name}"
        try:
            off, on = (sink.words(_rest(bridge=bridge), 0) for bridge in (False, True))
        except ValueError as problem:
            yield Flaw(place, f"the drive could not be switched: {problem}")
            continue
        if sink.name == _BRIDGE and on == off:
            yield Flaw(place, f"on and off are both {sink.register.on}")
        if sink.name in WANTED and sink.sent_for_zero:
            yield Flaw(place, f"0 would be sent as {sink.sent_for_zero:.4g}: it could not be safe")


def _rest(*, bridge: bool) -> Command:
    return Command(SAFE_COMMAND.current_scale_S, SAFE_COMMAND.boost_reference_V, bridge)


def _demand_flaws(sinks: Iterable[RegisterSink], demands: Demands) -> Iterator[Flaw]:
    """Every command within the limits must fit into its registers."""
    for sink in sinks:
        if sink.name not in WANTED:
            continue
        for command in demands.commands:
            try:
                sink.words(command, 0)
            except ValueError as problem:
                limit = f"cannot carry {getattr(command, sink.name):g}, a limit of [drive.limits]"
                yield Flaw(f"signals.command.{sink.name}", f"{limit}: {problem}")


def _combined_flaws(
    bus: ModbusBus, reads: tuple[Block, ...], writes: tuple[Block, ...]
) -> Iterator[Flaw]:
    if not bus.read_write:
        return
    if len(writes) != 1:
        yield Flaw("bus.read_write", f"the command must be one block, it is {len(writes)}")
    if not reads or reads[0].table != "holding":
        yield Flaw("bus.read_write", "function 23 reads holding registers, and none is measured")
