"""`[bus]` and `[signals]`: where the drive is reached and which signal is which quantity."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, field_validator, model_validator

from adaptdrive.config.section import FilePath, FiniteFloat, PositiveFloat, Section, key
from adaptdrive.config.services import check_host
from adaptdrive.config.units import Converted

MEASURED = ("boost_voltage_V", "line_voltage_V", "load_power_W", "output")
WORDS = ("counter", "fault", "bridge")
COMMANDED = ("current_scale_S", "boost_reference_V", "bridge")

Byte = Annotated[int, Field(ge=0, le=0xFF)]


class Crc(Section):
    """`[bus.integrity.MESSAGE.crc]`: a checksum by the parameters that catalogues of CRCs list."""

    width: Literal[8, 16, 32] = Field(description="bits; the checksum's signal has as many")
    poly: int = Field(ge=1, le=0xFFFF_FFFF, description="polynomial without its highest power")
    init: int = key(0, "start value", span=(0, 0xFFFF_FFFF))
    refin: bool = key(False, "the lowest bit of each byte comes first")
    refout: bool = key(False, "the result is mirrored before `xorout`")
    xorout: int = key(0, "final exclusive or", span=(0, 0xFFFF_FFFF))
    check: int | None = key(
        None, "checksum of `123456789` in the catalogue; `check` compares it", span=(0, 0xFFFF_FFFF)
    )
    covers: list[Byte] | None = key(
        None,
        "bytes of the frame that the checksum covers, in this order, from 0 on; its "
        "own bytes count as 0; all others when left out",
        min_length=1,
        max_length=64,
    )
    before: list[Byte] = key(
        [], "bytes before those of the frame, such as a data id", max_length=64
    )
    after: list[Byte] = key([], "bytes after those of the frame", max_length=64)
    by_counter: list[Byte] = key(
        [],
        "data id list of AUTOSAR profile 2: the byte at the alive counter's value comes last",
        max_length=256,
    )

    @model_validator(mode="after")
    def _fits_its_width(self) -> Self:
        for name in ("poly", "init", "xorout", "check"):
            value = getattr(self, name)
            if value is not None and value >> self.width:
                raise ValueError(f"{name} = {value:#x} has more than width = {self.width} bits")
        return self


class FrameIntegrity(Section):
    """`[bus.integrity.MESSAGE]`: how a message proves that it is alive and whole."""

    counter: str | None = key(None, "signal with the alive counter", min_length=1)
    max_jump: int = key(3, "largest accepted advance of the alive counter", ge=1)
    checksum: str | None = key(None, "signal with the checksum", min_length=1)
    algorithm: Literal["sae-j1850", "autosar-p01", "crc"] = key(
        "sae-j1850", "form of the checksum; `crc`: as the table `crc` says"
    )
    crc: Crc | None = key(None, "the form, with algorithm = `crc`")
    data_id: int = key(0, "data id of AUTOSAR profile 1", span=(0, 0xFFFF))
    data_id_mode: Literal["both", "alternating", "low", "nibble"] = key(
        "both", "bytes of the data id that the checksum of profile 1 runs over"
    )
    nibble: str | None = key(None, "signal with the low half of the data id's high byte (`nibble`)")


class BusSection(Section):
    """Properties that every kind of `[bus]` states of the drive behind it."""

    setup: dict[str, int | FiniteFloat | str] = key(
        {},
        "values that a drive needs before it takes commands (an unlock word, remote "
        "mode), by the name of their signal, register or object, in the order of writing; "
        "numbers or names of values. Written and read back when the bus is opened and when the "
        "drive returns; on CAN sent once",
    )
    setup_unread: list[str] = key([], "names in `setup` that do not read as they were written")

    @property
    def ticks_per_reading(self) -> int:
        """Half cycles from one reading of the drive to the next."""
        return 1

    @property
    def drive_clocks(self) -> bool:
        """True when the drive decides when a reading comes."""
        return False

    @property
    def has_bridge_words(self) -> bool:
        """True when the protocol itself switches the bridge and confirms that it is off."""
        return False


class CommandWatch(Section):
    """Supervision of the commands by the drive itself."""

    command_timeout_s: PositiveFloat | None = key(
        None,
        "the drive's own time-out: time without a command after which it opens its "
        "bridge; not known when left out",
        span=(0.01, 60.0),
    )


class Answering(Section):
    """Replies of a device that is asked for its values."""

    timeout_s: PositiveFloat = key(
        0.05, "longest time from a request to its reply", span=(1e-3, 2.0)
    )
    turnaround_s: float = key(
        0.005, "time that the device and the link take for a reply", span=(0.0, 1.0)
    )


class PolledBus(CommandWatch, Answering, BusSection):
    """Keys of `[bus]` for every drive that is asked for its values."""

    poll_ticks: int = key(
        12, "half line cycles from one poll of the drive to the next", span=(1, 120)
    )

    @property
    def ticks_per_reading(self) -> int:
        """Half cycles from one poll to the next."""
        return self.poll_ticks


class TcpHost(Section):
    """A device that is reached over TCP."""

    host: Annotated[str, AfterValidator(check_host)] = Field(
        description="name or address of the device or its gateway"
    )


class CanLink(Section):
    """Keys of `[bus]` for every kind of CAN bus."""

    interface: Literal["socketcan", "udp_multicast", "virtual"] = Field(
        description="python-can interface"
    )
    channel: str = Field(
        min_length=1, description="`can0`, a multicast group, or the name of a virtual bus"
    )
    udp_port: int = key(43113, "port of `udp_multicast`", span=(1, 65535))


class FrameAddress(Section):
    """`[bus.frames.MESSAGE]`: parts of the id of a J1939 message that the DBC states otherwise."""

    source: int | None = key(None, "source address: the lowest byte of the id", span=(0, 0xFD))
    destination: int | None = key(
        None, "destination address, of a PGN that has one", span=(0, 0xFF)
    )
    priority: int | None = key(None, "priority: the highest three bits of the id", span=(0, 7))

    def of(self, frame_id: int) -> int:
        """Return the id that a message of the DBC has with these parts."""
        parts = ((self.source, 0, 0xFF), (self.destination, 8, 0xFF), (self.priority, 26, 0x7))
        for value, shift, mask in parts:
            if value is not None:
                frame_id = frame_id & ~(mask << shift) | value << shift
        return frame_id


class CanDescription(CanLink):
    """Keys of a CAN bus that describe the frames on it."""

    fd: bool = key(False, "the bus carries CAN FD frames too")
    database: FilePath = Field(description="DBC file, relative to the configuration file")
    databases: list[FilePath] = key(
        [], "more DBC files of the same bus, such as one for each device"
    )
    frames: dict[str, FrameAddress] = key(
        {}, "by message: source address, destination and priority of a J1939 message"
    )
    integrity: dict[str, FrameIntegrity] = key({}, "alive counters and checksums by message")


class CanBus(CommandWatch, CanDescription, BusSection):
    """`[bus]` with `type = "can"`."""

    type: Literal["can"] = Field(description="kind of bus")
    bitrate_switch: bool = key(True, "send CAN FD frames with the faster data phase")
    clock: str = Field(description="message whose arrival is the fast tick")
    clock_ticks: int = key(
        1, "half line cycles from one clocking message to the next", span=(1, 120)
    )
    stale_cycles: float = key(
        3.0,
        "age at which a value is stale, in cycle times of its message (GenMsgCycleTime, else "
        "`clock_ticks`; at least that of `clock`); `interlocks.stale_s` where longer",
        span=(1.5, 10.0),
        allow_inf_nan=False,
    )

    @property
    def ticks_per_reading(self) -> int:
        """Half cycles from one clocking message to the next."""
        return self.clock_ticks

    @property
    def drive_clocks(self) -> bool:
        """True: each reading comes with the clocking message of the drive."""
        return True


class SignalSource(Converted):
    """One measured quantity: a signal, and a conversion to SI where its map has none."""

    signal: str = Field(
        min_length=1,
        description="`Message.Signal` on CAN, the register's name on Modbus, an object such as "
        "`0x6079`, `0x2001.2`, `Name` or `Record.Member` on CANopen",
    )


def _table(value: object) -> object:
    return {"signal": value} if isinstance(value, str) else value


Quantity = Annotated[
    SignalSource, BeforeValidator(_table, json_schema_input_type=SignalSource | str)
]


class SwitchSource(SignalSource):
    """One measured switch: a signal, and the value that means on."""

    on: int | str | None = key(
        None,
        "value that means on, or its name in the value table; 1 when left out, on Modbus any but 0",
    )


SwitchQuantity = Annotated[
    SwitchSource, BeforeValidator(_table, json_schema_input_type=SwitchSource | str)
]


class FaultSource(SignalSource):
    """`[[signals.faults]]`: one more fault word, whole or some of its bits."""

    mask: int | None = key(None, "bits that are faults; all of them when left out", ge=1)
    names: dict[str, str] = key(
        {}, "names of bits by number from 0 on, besides those of a DBC's value table"
    )

    @field_validator("names")
    @classmethod
    def _are_bits(cls, names: dict[str, str]) -> dict[str, str]:
        for bit in names:
            if not (bit.isdecimal() and int(bit) < 64):
                raise ValueError(f"{bit!r} is no number of a bit from 0 to 63")
        return names


FaultQuantity = Annotated[
    FaultSource, BeforeValidator(_table, json_schema_input_type=FaultSource | str)
]


class CommandSignal(SignalSource):
    """One commanded quantity: a signal, and its conversion from SI where the map has none."""


class CommandSwitch(Section):
    """One commanded switch: a signal, and the values that switch, or their names."""

    signal: str = Field(
        min_length=1, description="`Message.Signal` on CAN, the register's name on Modbus"
    )
    on: int | str | None = key(None, "value that switches on; 1, or the register's, when left out")
    off: int | str | None = key(
        None, "value that switches off; 0, or the register's, when left out"
    )


Commanded = Annotated[
    CommandSignal, BeforeValidator(_table, json_schema_input_type=CommandSignal | str)
]
CommandedSwitch = Annotated[
    CommandSwitch, BeforeValidator(_table, json_schema_input_type=CommandSwitch | str)
]


class CommandSignals(Section):
    """`[signals.command]`: which signals carry the command; absent ones are not sent."""

    current_scale_S: Commanded | None = key(None, "line-current scale k")
    boost_reference_V: Commanded | None = key(None, "V_c")
    bridge: CommandedSwitch | None = key(None, "bridge on (1) or off (0)")
    constants: dict[str, float | str] = key(
        {},
        "values sent with every command, by the name of their signal, register or object, as "
        "numbers or names of values; other signals of a DBC are sent as their start value",
    )


class Signals(Section):
    """`[signals]`: which signal is which quantity."""

    boost_voltage_V: Quantity | None = key(None, "boost capacitor voltage v_bst")
    line_voltage_V: Quantity | None = key(
        None, "line voltage, rms; needed where the daemon holds the voltage"
    )
    load_power_W: Quantity | None = key(
        None, "power into the load; needed where the daemon holds the voltage, and by a battery"
    )
    output: Quantity | None = key(None, "the regulated quantity")
    counter: Quantity | None = key(None, "half-cycle counter of the drive")
    fault: Quantity | None = key(None, "fault word, 0 = healthy")
    faults: list[FaultQuantity] = key([], "fault words whose bits the trip names with their signal")
    bridge: SwitchQuantity | None = key(None, "bridge is on")
    other: dict[str, Quantity] = key({}, "more values of the drive, for `[derived]`")
    stated: dict[str, FiniteFloat] = key(
        {}, "values that nobody measures, in SI units, such as line_voltage_V = 230.0"
    )
    command: CommandSignals = Field(default_factory=CommandSignals)

    def entries(self) -> Iterator[tuple[str, SignalSource, str]]:
        """Yield every value that the drive sends: its name, its entry, and the place of that."""
        named = {name: getattr(self, name) for name in (*MEASURED, *WORDS)}
        yield from ((name, one, f"signals.{name}") for name, one in named.items() if one)
        for number, fault in enumerate(self.faults):
            yield f"fault.{number}", fault, f"signals.faults.{number}"
        yield from ((name, one, f"signals.other.{name}") for name, one in self.other.items())
