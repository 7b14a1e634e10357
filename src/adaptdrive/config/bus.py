"""`[bus]` and `[signals]`: where the drive is reached and which signal is which quantity."""

import itertools
from collections.abc import Callable, Iterator
from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, BeforeValidator, Field, WrapValidator

from adaptdrive.config.section import (
    Converted,
    FilePath,
    FiniteFloat,
    PositiveFloat,
    Range,
    Section,
    key,
)
from adaptdrive.config.services import check_host
from adaptdrive.util.errors import Flaw

MEASURED = ("boost_voltage_V", "line_voltage_V", "load_power_W", "output")
WATCHED = ("fault", "faults", "warning")
WORDS = ("counter", *WATCHED, "bridge")
CODE = ".code"
"""End of the name of the quantity that has the codes of a watched word."""

COMMANDED = ("current_scale_S", "boost_reference_V", "bridge")

Byte = Annotated[int, Field(ge=0, le=0xFF)]


class Crc(Section):
    """`[bus.integrity.MESSAGE.crc]`: a checksum by the parameters that catalogues of CRCs list."""

    width: Literal[8, 16, 32]
    poly: int = Field(ge=1, le=0xFFFF_FFFF)
    init: int = key(0, span=(0, 0xFFFF_FFFF))
    refin: bool = False
    refout: bool = False
    xorout: int = key(0, span=(0, 0xFFFF_FFFF))
    check: int | None = key(None, span=(0, 0xFFFF_FFFF))
    covers: list[Byte] | None = key(None, min_length=1, max_length=64)
    before: list[Byte] = key([], max_length=64)
    after: list[Byte] = key([], max_length=64)
    by_counter: list[Byte] = key([], max_length=256)

    def flaws(self) -> Iterator[Flaw]:
        """Yield the numbers that are longer than the checksum."""
        for name in ("poly", "init", "xorout", "check"):
            if (value := getattr(self, name) or 0) >> self.width:
                yield Flaw("", f"{name} = {value:#x} has more than width = {self.width} bits")


class FrameIntegrity(Section):
    """`[bus.integrity.MESSAGE]`: how a message proves that it is alive and whole."""

    counter: str | None = key(None, min_length=1)
    max_jump: int = key(3, ge=1)
    checksum: str | None = key(None, min_length=1)
    algorithm: Literal["sae-j1850", "autosar-p01", "crc"] = "sae-j1850"
    crc: Crc | None = None
    data_id: int = key(0, span=(0, 0xFFFF))
    data_id_mode: Literal["both", "alternating", "low", "nibble"] = "both"
    nibble: str | None = None


class BusSection(Section):
    """Properties that every kind of `[bus]` states of the drive behind it."""

    has_bridge_words: ClassVar[bool] = False
    """True when the protocol itself switches the bridge and confirms that it is off."""

    setup: dict[str, int | FiniteFloat | str] = key({})
    setup_unread: list[str] = key([])

    @property
    def ticks_per_reading(self) -> int:
        """Half cycles from one reading of the drive to the next."""
        return 1

    @property
    def drive_clocks(self) -> bool:
        """True when the drive decides when a reading comes."""
        return False


class CommandWatch(Section):
    """Supervision of the commands by the drive itself."""

    command_timeout_s: PositiveFloat | None = key(None, span=(0.01, 60.0))


class Answering(Section):
    """Replies of a device that is asked for its values."""

    timeout_s: PositiveFloat = key(0.05, span=(1e-3, 2.0))
    turnaround_s: float = key(0.005, span=(0.0, 1.0))


class PolledBus(CommandWatch, Answering, BusSection):
    """Keys of `[bus]` for every drive that is asked for its values."""

    poll_ticks: int = key(12, span=(1, 120))

    @property
    def ticks_per_reading(self) -> int:
        """Half cycles from one poll to the next."""
        return self.poll_ticks


class TcpHost(Section):
    """A device that is reached over TCP."""

    host: Annotated[str, AfterValidator(check_host)]


class CanLink(Section):
    """Keys of `[bus]` for every kind of CAN bus."""

    interface: Literal["socketcan", "udp_multicast", "virtual"]
    channel: str = Field(min_length=1)
    udp_port: int = key(43113, span=(1, 65535))


class FrameAddress(Section):
    """`[bus.frames.MESSAGE]`: parts of the id of a J1939 message that the DBC states otherwise."""

    source: int | None = key(None, span=(0, 0xFD))
    destination: int | None = key(None, span=(0, 0xFF))
    priority: int | None = key(None, span=(0, 7))

    def of(self, frame_id: int) -> int:
        """Return the id that a message of the DBC has with these parts."""
        parts = ((self.source, 0, 0xFF), (self.destination, 8, 0xFF), (self.priority, 26, 0x7))
        for value, shift, mask in parts:
            if value is not None:
                frame_id = frame_id & ~(mask << shift) | value << shift
        return frame_id


class SignalRange(Range):
    """`[bus.ranges]`: what a value may be, in place of the range of the DBC."""


class CanDescription(CanLink):
    """Keys of a CAN bus that describe the frames on it."""

    fd: bool = False
    database: FilePath
    databases: list[FilePath] = key([])
    frames: dict[str, FrameAddress] = key({})
    polled: dict[str, Literal["rtr", "pgn"]] = key({})
    own_address: int = key(0xF9, span=(0, 0xFD))
    ranges: dict[str, SignalRange] = key({})
    integrity: dict[str, FrameIntegrity] = key({})


class CanBus(CommandWatch, CanDescription, BusSection):
    """`[bus]` with `type = "can"`."""

    type: Literal["can"]
    bitrate_switch: bool = True
    clock: str
    clock_ticks: int = key(1, span=(1, 120))
    send_every_s: dict[str, Annotated[PositiveFloat, Field(le=10.0)]] = key({})
    stale_cycles: float = key(3.0, span=(1.5, 10.0), allow_inf_nan=False)

    @property
    def clock_message(self) -> str:
        """Message that clocks, or one page of it."""
        return self.clock.partition(".")[0]

    @property
    def clock_signal(self) -> str | None:
        """Signal whose page clocks, None where each frame of the message does."""
        return self.clock.partition(".")[2] or None

    @property
    def ticks_per_reading(self) -> int:
        """Half cycles from one clocking message to the next."""
        return self.clock_ticks

    @property
    def drive_clocks(self) -> bool:
        """True: each reading comes with the clocking message of the drive."""
        return True


class CanOpenBus(CanLink, BusSection):
    """`[bus]` with `type = "canopen"`: a CiA 402 drive."""

    has_bridge_words: ClassVar[bool] = True
    """True: the controlword switches the bridge, the statusword confirms it."""

    type: Literal["canopen"]
    eds: FilePath
    node_id: int = Field(ge=1, le=127)
    own_node_id: int = key(127, span=(1, 127))
    sync: Literal["drive", "daemon"] = "daemon"
    heartbeat_s: PositiveFloat = key(0.02, span=(0.005, 1.0))
    heartbeat_timeout_s: PositiveFloat = key(0.1, le=2.0)
    sdo_timeout_s: PositiveFloat = key(0.3, span=(0.01, 10.0))

    @property
    def command_timeout_s(self) -> float:
        """Time after a command for which the drive does not miss the heartbeat.

        The heartbeat before that command may be the last one: not each command has one.
        """
        return self.heartbeat_timeout_s - self.heartbeat_s

    @property
    def drive_clocks(self) -> bool:
        """True when the drive sends SYNC."""
        return self.sync == "drive"


class SignalSource(Converted):
    """One quantity: a signal, and a conversion to SI, or from it, where its map has none."""

    signal: str = Field(min_length=1)


def _table(value: object) -> object:
    return {"signal": value} if isinstance(value, str) else value


def _or_name(section: type[Section]) -> BeforeValidator:
    """Return what takes the name of a signal for a table with that name alone."""
    return BeforeValidator(_table, json_schema_input_type=section | str)


Quantity = Annotated[SignalSource, _or_name(SignalSource)]


class SwitchSource(SignalSource):
    """One measured switch: a signal, and the value that means on."""

    on: int | str | None = None


SwitchQuantity = Annotated[SwitchSource, _or_name(SwitchSource)]


class FaultSource(SignalSource):
    """`signals.fault`, `faults`, `warning`: a watched word, whole or some bits, or a state."""

    mask: int | None = key(None, ge=1)
    healthy: list[int | str] = key([])
    names: dict[str, str] = key({})
    code: Quantity | None = None

    def flaws(self) -> Iterator[Flaw]:
        """Yield the names of what is no bit or no value, or none of the mask."""
        yield from super().flaws()
        for number in self.names:
            if not (number.isdecimal() and (self.healthy or int(number) < 64)):
                what = "a value" if self.healthy else "a bit from 0 to 63"
                yield Flaw("names", f"{number!r} is no number of {what}")
            elif outside := self._word(number) & ~self.bits:
                what = f"{number} is outside mask = {self.bits:#x}"
                yield Flaw("names", f"{what}: leave its name out, or add {outside:#x}")

    @property
    def named(self) -> dict[int, str]:
        """Names by word: with `healthy` by value, else by the one bit that is set."""
        return {self._word(number): name for number, name in self.names.items()}

    def _word(self, number: str) -> int:
        return int(number) if self.healthy else 1 << int(number)

    @property
    def bits(self) -> int:
        """The watched bits, -1 for all."""
        return -1 if self.mask is None else self.mask


FaultQuantity = Annotated[FaultSource, _or_name(FaultSource)]


def _several(given: object, listed: Callable[[object], object]) -> object:
    """A list of words; errors of one that stands alone have no number."""
    return listed(given) if isinstance(given, list) else [FaultSource.model_validate(_table(given))]


FaultQuantities = Annotated[
    list[FaultQuantity],
    WrapValidator(_several, json_schema_input_type=FaultSource | str | list[FaultSource | str]),
]


class CommandSwitch(Section):
    """One commanded switch: a signal, and the values that switch, or their names."""

    signal: str = Field(min_length=1)
    on: int | str | None = None
    off: int | str | None = None
    off_signal: str | None = None


CommandedSwitch = Annotated[CommandSwitch, _or_name(CommandSwitch)]


class CommandSignals(Section):
    """`[signals.command]`: which signals carry the command; absent ones are not sent."""

    current_scale_S: Quantity | None = None
    boost_reference_V: Quantity | None = None
    bridge: CommandedSwitch | None = None
    reset: CommandedSwitch | None = None
    constants: dict[str, float | str] = key({})
    copies: dict[str, Quantity] = key({})


class Signals(Section):
    """`[signals]`: which signal is which quantity."""

    boost_voltage_V: Quantity | None = None
    line_voltage_V: Quantity | None = None
    load_power_W: Quantity | None = None
    output: Quantity | None = None
    counter: Quantity | None = None
    fault: FaultQuantities = key([])
    faults: FaultQuantities = key([])
    warning: FaultQuantities = key([])
    bridge: SwitchQuantity | None = None
    other: dict[str, Quantity] = key({})
    stated: dict[str, FiniteFloat] = key({})
    command: CommandSignals = Field(default_factory=CommandSignals)

    def entries(self) -> Iterator[tuple[str, SignalSource, str]]:
        """Yield every value that the drive sends: its name, its entry, and the place of that."""
        named = {name: getattr(self, name) for name in (*MEASURED, *WORDS)}
        named |= dict.fromkeys(WATCHED) | dict(self.watched())
        named |= {f"{name}{CODE}": one.code for name, one in self.watched()}
        yield from ((name, one, f"signals.{name}") for name, one in named.items() if one)
        yield from ((name, one, f"signals.other.{name}") for name, one in self.other.items())

    def watched(self) -> Iterator[tuple[str, FaultSource]]:
        """Yield the words of faults and warnings by key; those of a longer list have numbers."""
        for name in WATCHED:
            words: list[FaultSource] = getattr(self, name)
            for number, one in enumerate(words):
                yield (f"{name}.{number}" if len(words) > 1 else name), one

    def flaws(self) -> Iterator[Flaw]:
        """Yield the bits that are watched twice."""
        for (first, one), (place, other) in itertools.combinations(self.watched(), 2):
            twice = one.bits & other.bits if one.signal == other.signal else 0
            if twice and one.healthy == other.healthy:
                which = "the word" if twice < 0 else f"bits {twice:#x}"
                problem = f"{which} of {other.signal!r} is watched by signals.{first} already"
                yield Flaw(place, f"{problem}: leave one out, or give each a mask")
