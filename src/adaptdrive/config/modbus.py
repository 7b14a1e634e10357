"""`[bus]` of a drive on Modbus: the link, and the register map that describes the drive."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, field_validator

from adaptdrive.config.bus import Answering, PolledBus, TcpHost
from adaptdrive.config.section import FilePath, FiniteFloat, PositiveFloat, Range, Section, key


class RegisterRange(Range):
    """`[bus.registers.NAME.range]`: what a value may be, both ends included."""


class Register(Section):
    """`[bus.registers.NAME]`: one value of the drive's register map."""

    address: int = Field(
        ge=0, le=0xFFFF, description="zero-based address: 0 is 30001 or 40001 in a manual"
    )
    table: Literal["input", "holding", "coil", "discrete"] = Field(
        description="input registers (3xxxx), holding registers (4xxxx), coils (0xxxx) or discrete "
        "inputs (1xxxx)"
    )
    type: Literal["uint16", "int16", "uint32", "int32", "float32", "uint64", "int64", "float64"] = (
        key("uint16", "how the value is coded; 32 bits take two registers, 64 bits four")
    )
    word_order: Literal["big", "little"] = key(
        "big", "register that comes first of several: the high or the low one"
    )
    byte_order: Literal["big", "little"] = key("big", "byte that comes first in each register")
    scale: FiniteFloat = key(1.0, "units per count")
    unit: str = key("", "unit of the scaled value, for people")
    range: RegisterRange | None = key(None, "a scaled value outside is refused")
    not_available: int | None = key(
        None,
        "count or word that means `no value`, such as 0x7F7FFFFF of a float32; all "
        "ones (0x8000… when signed) when left out",
    )
    bit: int | None = key(None, "take this bit alone, 0 is the lowest", span=(0, 63))
    mask: int | None = key(
        None,
        "take these bits alone, such as 0x0F00, as a number from 0 on; bits of no "
        "field are written as 0",
        ge=1,
    )
    names: dict[str, int] = key({}, "names of its counts, such as { Stop = 0, Run = 1 }")
    write_limit: int | None = key(
        None,
        "writes a day, of those in the life of the register: it is written on change, "
        "at the earliest after its share of a day, and for each switch of the bridge",
        ge=24,
    )
    on: int = key(1, "count that is written to switch on")
    off: int = key(0, "count that is written to switch off")

    @property
    def words(self) -> int:
        """Registers that the value takes."""
        return {"16": 1, "32": 2, "64": 4}[self.type[-2:]]

    @property
    def real(self) -> bool:
        """True for a floating-point number."""
        return self.type.startswith("float")

    @property
    def bits(self) -> int | None:
        """Mask of the bits that are taken, None for the whole value."""
        return self.mask if self.bit is None else 1 << self.bit

    @property
    def switches(self) -> bool:
        """True for a coil or a discrete input, which is one bit."""
        return self.table in {"coil", "discrete"}

    @property
    def end(self) -> int:
        """Address behind the value."""
        return self.address + self.words


class Heartbeat(Section):
    """`[bus.heartbeat]`: how drive and daemon see that the other one is alive."""

    drive: str | None = key(
        None, "register that the drive advances; while it stands still, no reading is fresh"
    )
    drive_timeout_s: PositiveFloat | None = key(
        None, "longest time between two advances; one poll when left out", le=2.0
    )
    daemon: str | None = key(None, "register that the daemon advances with each command")


class ModbusLink(Answering):
    """Keys of every link to devices on Modbus."""

    device_id: int = key(1, "device (slave, unit) id; 0 on TCP only", span=(0, 255))
    zero_based: bool = key(
        False,
        "accept addresses from 30001 to 39999 and 40001 to 49999; refused without "
        "it, as they look like labels of a manual",
    )
    max_gap: int = key(4, "unmapped registers that a read may run across", span=(0, 123))
    max_block: int = key(125, "registers that the device gives in one reply", span=(2, 125))

    @property
    def numbered(self) -> bool:
        """True where each reply has the number of its request."""
        return getattr(self, "framing", "rtu") == "tcp"


class TcpLink(ModbusLink, TcpHost):
    """A link over TCP."""

    port: int = key(502, "port of the device", span=(1, 65535))
    framing: Literal["tcp", "rtu"] = key(
        "tcp", "form of the packets; `rtu`: of a serial line, through a plain gateway"
    )


class RtuLink(ModbusLink):
    """A link over a serial line."""

    device: FilePath = Field(description="serial port, relative to the configuration file")
    baud: int = key(19200, "bits per second", span=(300, 4_000_000))
    parity: Literal["even", "odd", "none"] = key("even", "parity bit")
    stop_bits: Literal[1, 2] = key(1, "stop bits")

    @field_validator("device_id")
    @classmethod
    def _is_one_device(cls, device_id: int) -> int:
        if device_id == 0:
            raise ValueError("0 is all devices of a serial line, and none of them replies")
        return device_id


class ModbusBus(PolledBus, ModbusLink):
    """Keys of `[bus]` for every kind of Modbus."""

    write: Literal["multiple", "single"] = key(
        "multiple", "write registers together (function 16) or each alone (function 6)"
    )
    command_interval_s: float = key(
        0.0,
        "longest time between writes of an unchanged command; 0: with each poll",
        span=(0.0, 3600.0),
    )
    read_write: bool = key(False, "write and read in one exchange (function 23)")
    heartbeat: Heartbeat = Field(default_factory=Heartbeat)
    registers: dict[str, Register] = key({}, "register map, by name")


class ModbusTcp(ModbusBus, TcpLink):
    """`[bus]` with `type = "modbus-tcp"`."""

    type: Literal["modbus-tcp"] = Field(description="kind of bus")


class ModbusRtu(ModbusBus, RtuLink):
    """`[bus]` with `type = "modbus-rtu"`."""

    type: Literal["modbus-rtu"] = Field(description="kind of bus")
