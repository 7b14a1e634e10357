"""`[bus]` of a drive that is polled: a register map on Modbus, or lines of SCPI."""

import math
import re
from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from adaptdrive.config.bus import Answering, PolledBus, TcpHost
from adaptdrive.config.section import FilePath, PositiveFloat, Range, Scale, Section, key
from adaptdrive.util.errors import Flaw

# `[bus]` of a drive on Modbus: the link, and the register map that describes the drive.


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


# `[bus]` of a supply that speaks SCPI, lines of text over TCP, and the values behind them.

_STEP = 8
"""Registers from one value to the next: four hold it, and a gap keeps requests apart."""

_REAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([Ee][+-]?\d+)?", re.ASCII)
_WHOLE = re.compile(r"[+-]?(0[xX]|#[hHqQbB])?([0-9A-Fa-f]+)(,.*)?", re.ASCII)
_BASES = {"0x": 16, "#h": 16, "#q": 8, "#b": 2}
"""Base of a whole number by what stands before it (IEEE 488.2, 8.7.4)."""


class ScpiValue(Section):
    """`[bus.values.NAME]`: one value of the supply, and the lines that ask for it and set it."""

    query: str | None = key(None, pattern=r"^[!-~][ -~]*\?[ -~]*$")
    write: str | None = key(None, pattern=r"^[!-~][ -~]*$")
    reply: str = "(.*)"
    answer: str | None = None
    integer: bool = False
    base: Literal[10, 16] = 10
    bit: int | None = key(None, span=(0, 31))
    mask: int | None = key(None, span=(1, 0xFFFF_FFFF))
    unit: str = ""
    range: RegisterRange | None = None
    names: dict[str, int] = key({})

    def flaws(self) -> Iterator[Flaw]:
        """Yield what keeps a value from being asked for, and from being set."""
        if self.query is None and self.write is None:
            yield Flaw("", "needs `query` or `write`")
        try:
            for number in (0.5, *self.names.values()):
                self.line(number)
        except (ValueError, LookupError, AttributeError) as problem:
            yield Flaw("", f"write = {self.write!r} takes no value: {problem}")
        try:
            re.compile(self.answer or "")
        except re.error as problem:
            yield Flaw("answer", f"{self.answer!r} is no regular expression: {problem}")
        try:
            groups = re.compile(self.reply).groups
        except re.error as problem:
            yield Flaw("reply", f"{self.reply!r} is no regular expression: {problem}")
        else:
            if groups != 1:
                yield Flaw("reply", f"{self.reply!r} has {groups} groups: one is the value")
        if len(self._bits) > 1:
            yield Flaw("mask", "is for several bits, and `bit` for one")
        elif self._bits and self.write is not None:
            yield Flaw(self._bits[0], "is for a value that is read alone: `write` sets the word")

    @property
    def _bits(self) -> list[str]:
        return [name for name in ("bit", "mask") if getattr(self, name) is not None]

    @property
    def whole(self) -> bool:
        """True for a whole number."""
        return self.integer or self.base == 16 or bool(self._bits or self.names)

    def line(self, number: float) -> str:
        """Return the command for a number.

        Args:
            number: A finite value in the unit of the supply.
        """
        words = (name for name, one in self.names.items() if one == number)
        return (self.write or "").format(next(words, number))

    def number(self, reply: str) -> float:
        """Return the number that a reply stands for, NaN for none; of a word with all its bits.

        Args:
            reply: The line without its end.
        """
        part = re.fullmatch(self.reply, reply)
        text = part[1].strip() if part else ""
        if text in self.names:
            return self.names[text]
        if self.whole:
            return self._whole(text)
        return float(text) if _REAL.fullmatch(text) else math.nan

    def _whole(self, text: str) -> float:
        """Return a whole number without its sign, NaN for none."""
        found = _WHOLE.fullmatch(text)
        base = self.base if found is None else _BASES.get((found[1] or "").lower(), self.base)
        try:
            return int(found[2], base) if found else math.nan
        except ValueError:
            return math.nan

    def register(self, address: int) -> Register:
        """Return the value as four registers.

        Args:
            address: The first of them.
        """
        return Register(
            address=address,
            table="input" if self.write is None else "holding",
            type="uint64" if self.whole else "float64",
            unit=self.unit,
            range=self.range,
            names=self.names,
            bit=self.bit,
            mask=self.mask,
        )


class ScpiBus(PolledBus, TcpHost):
    """`[bus]` with `type = "scpi"`."""

    type: Literal["scpi"]
    port: int = key(5025, span=(1, 65535))
    line_end: Literal["LF", "CR", "CRLF"] = "LF"
    done: str = key("*OPC?", pattern=r"^([!-~][ -~]*\?)?$")
    values: dict[str, ScpiValue] = key({}, max_length=1000)

    @property
    def end(self) -> bytes:
        """End of a line that is sent."""
        return {"LF": b"\n", "CR": b"\r", "CRLF": b"\r\n"}[self.line_end]

    def as_registers(self) -> ModbusTcp:
        """Return a bus with a register for each value, which is polled in the same way."""
        values, polled = self.values.items(), self.model_dump(include={*PolledBus.model_fields})
        unread = [name for name, value in values if value.query is None]
        return ModbusTcp(
            type="modbus-tcp",
            host=self.host,
            port=self.port,
            **{**polled, "setup_unread": [*self.setup_unread, *unread]},
            max_gap=0,
            max_block=4,
            registers={
                name: value.register(_STEP * number) for number, (name, value) in enumerate(values)
            },
        )
