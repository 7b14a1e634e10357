"""`[bus]` of a drive on Modbus: the link, and the register map that describes the drive."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from adaptdrive.config.bus import Answering, PolledBus, TcpHost
from adaptdrive.config.section import FilePath, PositiveFloat, Range, Scale, Section, key
from adaptdrive.util.errors import Flaw


class RegisterRange(Range):
    """`[bus.registers.NAME.range]`: what a value may be, both ends included."""


class Register(Section):
    """`[bus.registers.NAME]`: one value of the drive's register map."""

    address: int = Field(ge=0, le=0xFFFF)
    table: Literal["input", "holding", "coil", "discrete"]
    type: Literal["uint16", "int16", "uint32", "int32", "float32", "uint64", "int64", "float64"] = (
        "uint16"
    )
    word_order: Literal["big", "little"] = "big"
    byte_order: Literal["big", "little"] = "big"
    scale: Scale = 1.0
    unit: str = ""
    range: RegisterRange | None = None
    not_available: int | None = None
    bit: int | None = key(None, span=(0, 63))
    mask: int | None = key(None, ge=1)
    names: dict[str, int] = key({})
    write_limit: int | None = key(None, ge=24)
    on: int = 1
    off: int = 0

    def flaws(self) -> Iterator[Flaw]:
        """Yield what no register has."""
        given, bits, size = self.not_available, self.bits, 16 * self.words
        if self.end > 0x10000:
            yield Flaw("address", f"{self.address} leaves no room for its registers")
        lowest = 0 if self.type.startswith("uint") else -1 << (size - 1)
        if given is not None and not lowest <= given < 1 << size:
            yield Flaw("not_available", f"{self.type} has no count {given}")
        if bits is not None and (self.real or bits >> size):
            name, wrong = "bit", f"bit {self.bit}"
            if self.mask is not None:
                name, wrong = "mask", f"bits {self.mask:#x}"
            yield Flaw(name, f"{self.type} has no {wrong}")
        if self.bit is not None and self.mask is not None:
            yield Flaw("mask", "is for several bits, and `bit` for one")
        if self.switches and (self.type != "uint16" or bits is not None):
            yield Flaw("type", f"a {self.table} is one bit: leave type, bit and mask out")

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

    drive: str | None = None
    drive_timeout_s: PositiveFloat | None = key(None, le=2.0)
    daemon: str | None = None


class ModbusLink(Answering):
    """Keys of every link to devices on Modbus."""

    device_id: int = key(1, span=(0, 255))
    zero_based: bool = False
    max_gap: int = key(4, span=(0, 123))
    max_block: int = key(125, span=(2, 125))

    @property
    def numbered(self) -> bool:
        """True where each reply has the number of its request."""
        return getattr(self, "framing", "rtu") == "tcp"


class TcpLink(ModbusLink, TcpHost):
    """A link over TCP."""

    port: int = key(502, span=(1, 65535))
    framing: Literal["tcp", "rtu"] = "tcp"


class RtuLink(ModbusLink):
    """A link over a serial line."""

    device: FilePath
    baud: int = key(19200, span=(300, 4_000_000))
    parity: Literal["even", "odd", "none"] = "even"
    stop_bits: Literal[1, 2] = 1

    def flaws(self) -> Iterator[Flaw]:
        """Yield an id that no device has."""
        if self.device_id == 0:
            yield Flaw("device_id", "0 is all devices of a serial line, and none of them replies")


class ModbusBus(PolledBus, ModbusLink):
    """Keys of `[bus]` for every kind of Modbus."""

    write: Literal["multiple", "single"] = "multiple"
    command_interval_s: float = key(0.0, span=(0.0, 3600.0))
    read_write: bool = False
    heartbeat: Heartbeat = Field(default_factory=Heartbeat)
    registers: dict[str, Register] = key({})


class ModbusTcp(ModbusBus, TcpLink):
    """`[bus]` with `type = "modbus-tcp"`."""

    type: Literal["modbus-tcp"]


class ModbusRtu(ModbusBus, RtuLink):
    """`[bus]` with `type = "modbus-rtu"`."""

    type: Literal["modbus-rtu"]
