"""`[bus]` and `[signals]`: where the drive is reached and which signal is which quantity."""

import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import BeforeValidator, Field, WrapValidator

from adaptdrive.config.section import (
    Converted,
    FilePath,
    FiniteFloat,
    PositiveFloat,
    Range,
    Section,
    key,
)
from adaptdrive.util.errors import Flaw
from adaptdrive.util.quantity import MEASURED

WATCHED = ("fault", "warning")
WORDS = ("counter", *WATCHED, "bridge")
CODE = ".code"
"""End of the name of the quantity that has the codes of a watched word."""

COMMANDED = ("current_scale_S", "boost_reference_V", "bridge")

Byte = Annotated[int, Field(ge=0, le=0xFF)]


class Crc(Section):
    """`[bus.integrity.MESSAGE.crc]`: a checksum by the parameters that catalogues of CRCs list."""

    poly: int = Field(ge=1, le=0xFFFF_FFFF)
    """polynomial without its highest power, which is the bits of the signal: 8, 16 or 32"""
    init: int = key(0, span=(0, 0xFFFF_FFFF))
    """start value"""
    reflected: bool = False
    """the lowest bit comes first: `refin` and `refout` of a catalogue"""
    xorout: int = key(0, span=(0, 0xFFFF_FFFF))
    """final exclusive or"""
    before: list[Byte] = key([], max_length=64)
    """bytes before those of the frame, such as a data id"""
    after: list[Byte] = key([], max_length=64)
    """bytes after those of the frame"""
    by_counter: list[Byte] = key([], max_length=256)
    """data id list of AUTOSAR profile 2, as in cars of Volkswagen's MQB: the byte at the alive
    counter's value comes last"""


class FrameIntegrity(Section):
    """`[bus.integrity.MESSAGE]`: how a message proves that it is alive and whole."""

    counter: str | None = key(None, min_length=1)
    """signal with the alive counter"""
    checksum: str | None = key(None, min_length=1)
    """signal with the checksum"""
    crc: Crc | None = None
    """form of the checksum; when left out that of `data_id`, or SAE J1850 with eight bits"""
    data_id: int | None = key(None, span=(0, 0xFFFF))
    """data id of AUTOSAR profile 1"""
    data_id_mode: Literal["both", "alternating", "low"] = "both"
    """bytes of the data id that the checksum of profile 1 runs over, without `nibble`"""
    nibble: str | None = None
    """signal with the low half of the data id's high byte; the checksum runs over its low byte"""


class BusSection(Section):
    """Properties that every kind of `[bus]` states of the drive behind it."""

    has_bridge_words: ClassVar[bool] = False
    """True when the protocol itself switches the bridge and confirms that it is off."""

    setup: dict[str, int | FiniteFloat | str] = key({})
    """values that a drive needs before it takes commands (an unlock word, remote mode), by the name
    of their signal, register or object, in the order of writing; numbers or names of values.
    Written and read back when the bus is opened and when the drive returns; on CAN sent when the
    bus is opened, before the bridge comes on, and each second while the drive is off and silent"""
    setup_unread: list[str] = key([])
    """names in `setup` that do not read as they were written"""

    @property
    def ticks_per_reading(self) -> int:
        """Half cycles from one reading of the drive to the next."""
        return 1


class CanLink(Section):
    """Keys of `[bus]` for every kind of CAN bus."""

    interface: Literal["socketcan", "udp_multicast", "virtual"]
    """python-can interface"""
    channel: str = Field(min_length=1)
    """`can0`, a multicast group, or the name of a virtual bus"""
    udp_port: int = key(43113, span=(1, 65535))
    """port of `udp_multicast`"""


class FrameAddress(Section):
    """`[bus.frames.MESSAGE]`: parts of the id of a J1939 message that the DBC states otherwise."""

    source: int | None = key(None, span=(0, 0xFD))
    """source address: the lowest byte of the id"""
    destination: int | None = key(None, span=(0, 0xFF))
    """destination address, of a PGN that has one"""
    priority: int | None = key(None, span=(0, 7))
    """priority: the highest three bits of the id"""

    def of(self, frame_id: int) -> int:
        """Return the id that a message of the DBC has with these parts."""
        parts = ((self.source, 0, 0xFF), (self.destination, 8, 0xFF), (self.priority, 26, 0x7))
        for value, shift, mask in parts:
            if value is not None:
                frame_id = frame_id & ~(mask << shift) | value << shift
        return frame_id


def _as_list(given: object) -> object:
    return given if isinstance(given, list) else [given]


FilePaths = Annotated[
    list[FilePath],
    Field(min_length=1),
    BeforeValidator(_as_list, json_schema_input_type=Path | list[Path]),
]


class CanDescription(CanLink):
    """Keys of a CAN bus that describe the frames on it."""

    fd: bool = False
    """the bus carries CAN FD frames too, with the bit rate of their data that its interface has"""
    database: FilePaths
    """DBC file, relative to the configuration file, or a list of them, such as one for each
    device"""
    frames: dict[str, FrameAddress] = key({})
    """by message: source address, destination and priority of a J1939 message"""
    polled: dict[str, Literal["rtr", "pgn"]] = key({})
    """messages that are asked for, each `clock_ticks` or `cycle_s`, by a remote frame (`rtr`) or a
    request of J1939 to their sender (`pgn`)"""
    ranges: dict[str, Range] = key({})
    """ranges by `Message.Signal`, in the unit of the DBC, where those of the DBC are wrong"""
    integrity: dict[str, FrameIntegrity] = key({})
    """alive counters and checksums by message"""


class CanBus(CanDescription, BusSection):
    """`[bus]` with `type = "can"`."""

    command_timeout_s: PositiveFloat | None = key(None, span=(0.01, 60.0))
    """the drive's own time-out: time without a command after which it opens its bridge; not known
    when left out"""
    type: Literal["can"]
    """kind of bus"""
    clock: str
    """message whose arrival is the fast tick, or `MESSAGE.SIGNAL` where only the page with that
    signal is"""
    clock_ticks: int = key(1, span=(1, 120))
    """half line cycles from one clocking message to the next"""
    send_every_s: dict[str, Annotated[PositiveFloat, Field(le=10.0)]] = key({})
    """messages of the command that carry constants alone and are sent less often than it, and how
    often: `{ WakeUp = 0.1 }`"""
    stale_cycles: float = key(3.0, span=(1.5, 10.0), allow_inf_nan=False)
    """age at which a value is stale, in cycle times of its message (GenMsgCycleTime, else
    `clock_ticks`; at least that of `clock`); `interlocks.stale_s` where longer"""

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


class CanOpenBus(CanLink, BusSection):
    """`[bus]` with `type = "canopen"`: a CiA 402 drive."""

    has_bridge_words: ClassVar[bool] = True  # the controlword switches it, the statusword confirms

    type: Literal["canopen"]
    """kind of bus"""
    eds: FilePath
    """electronic data sheet of the drive, relative to the configuration file"""
    node_id: int = Field(ge=1, le=127)
    """node id of the drive"""
    own_node_id: int = key(127, span=(1, 127))
    """node id of the daemon, for its heartbeat; no other node may have it"""
    sync: Literal["drive", "daemon"] = "daemon"
    """sender of SYNC each half line cycle; the drive sends it at a fixed line phase"""
    heartbeat_timeout_s: PositiveFloat = key(0.1, span=(0.025, 2.0))
    """silence after which the drive makes itself safe, and the daemon trips; each sends a heartbeat
    five times as often"""
    sdo_timeout_s: PositiveFloat = key(0.3, span=(0.01, 10.0))
    """longest time from an SDO request to its reply"""

    @property
    def heartbeat_s(self) -> float:
        """Time between two heartbeats, of the drive and of the daemon: three may be lost."""
        return self.heartbeat_timeout_s / 5.0

    @property
    def command_timeout_s(self) -> float:
        """Time after a command for which the drive does not miss the heartbeat.

        The heartbeat before that command may be the last one: not each command has one.
        """
        return self.heartbeat_timeout_s - self.heartbeat_s


class SignalSource(Converted):
    """One quantity: a signal, and a conversion to SI, or from it, where its map has none."""

    signal: str = Field(min_length=1)
    """`Message.Signal` on CAN, the register's name on Modbus, an object such as `0x6079`,
    `0x2001.2`, `Name` or `Record.Member` on CANopen"""


def _table(value: object) -> object:
    return {"signal": value} if isinstance(value, str) else value


def _or_name(section: type[Section]) -> BeforeValidator:
    """Return what takes the name of a signal for a table with that name alone."""
    return BeforeValidator(_table, json_schema_input_type=section | str)


Quantity = Annotated[SignalSource, _or_name(SignalSource)]


class SwitchSource(SignalSource):
    """One measured switch: a signal, and the value that means on."""

    on: int | str | None = None
    """value that means on, or its name in the value table; 1 when left out, on Modbus any but 0"""


SwitchQuantity = Annotated[SwitchSource, _or_name(SwitchSource)]


class FaultSource(SignalSource):
    """`signals.fault` and `warning`: a watched word, whole or some bits, or a state."""

    mask: int | None = key(None, ge=1)
    """watched bits; all when left out"""
    healthy: list[int | str] = key([])
    """values or names besides 0 that are no faults"""
    names: dict[str, str] = key({})
    """names of bits by number from 0 on (with `healthy` of values), besides those of a value
    table"""
    code: Quantity | None = None
    """signal with the code of the fault, which the trip names too; it trips nothing itself"""

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
    """`Message.Signal` on CAN, the register's name on Modbus"""
    on: int | str | None = None
    """value that switches on; 1, or the register's, when left out"""
    off: int | str | None = None
    """value that switches off; 0, or the register's, when left out"""
    off_signal: str | None = None
    """coil that is set to switch off, where `signal` is one that is set to switch on only"""


CommandedSwitch = Annotated[CommandSwitch, _or_name(CommandSwitch)]


class CommandSignals(Section):
    """`[signals.command]`: which signals carry the command; absent ones are not sent."""

    current_scale_S: Quantity | None = None
    """line-current scale k"""
    boost_reference_V: Quantity | None = None
    """V_c"""
    bridge: CommandedSwitch | None = None
    """bridge on (1) or off (0)"""
    reset: CommandedSwitch | None = None
    """reset of a fault of the drive, on and off again at the command `reset` (not of CANopen, whose
    controlword has one)"""
    constants: dict[str, float | str] = key({})
    """values sent with every command, by the name of their signal, register or object, as numbers
    or names of values; other signals of a DBC are sent as their start value"""
    copies: dict[str, Quantity] = key({})
    """measured values that a drive on CAN gets back with every command, by their name in
    `[signals]` or `[signals.other]`; one that is stale or does not fit is sent as not available"""


class Signals(Section):
    """`[signals]`: which signal is which quantity."""

    boost_voltage_V: Quantity | None = None
    """boost capacitor voltage v_bst; V_c where the drive holds it and it is left out"""
    line_voltage_V: Quantity | None = None
    """line voltage, rms; needed where the daemon holds the voltage"""
    load_power_W: Quantity | None = None
    """power into the load; needed where the daemon holds the voltage, and by a battery"""
    output: Quantity | None = None
    """the regulated quantity"""
    counter: Quantity | None = None
    """half-cycle counter of the drive"""
    fault: FaultQuantities = key([])
    """fault words; 0 is healthy"""
    warning: FaultQuantities = key([])
    """words whose changes are events, and which trip nothing"""
    bridge: SwitchQuantity | None = None
    """bridge is on"""
    other: dict[str, Quantity] = key({})
    """more values of the drive, for `[derived]`"""
    stated: dict[str, FiniteFloat] = key({})
    """values that nobody measures, in SI units, such as line_voltage_V = 230.0"""
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
