"""`[bus]` of a drive that is polled: a register map on Modbus, or lines of SCPI."""

import math
import re
from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from adaptdrive.config.bus import BusSection
from adaptdrive.config.section import FilePath, Host, PositiveFloat, Range, Scale, Section, key
from adaptdrive.util.errors import Flaw

# Keys of every device that is polled.


class Answering(Section):
    """Replies of a device that is asked for its values."""

    timeout_s: PositiveFloat = key(0.05, span=(1e-3, 2.0))
    """longest time from a request to its reply"""
    turnaround_s: float = key(0.005, span=(0.0, 1.0))
    """time that the device and the link take for a reply"""


class PolledBus(Answering, BusSection):
    """Keys of `[bus]` for every drive that is asked for its values."""

    command_timeout_s: PositiveFloat | None = key(None, span=(0.01, 60.0))
    """the drive's own time-out: time without a command after which it opens its bridge; not known
    when left out"""
    poll_ticks: int = key(12, span=(1, 120))
    """half line cycles from one poll of the drive to the next"""

    @property
    def ticks_per_reading(self) -> int:
        """Half cycles from one poll to the next."""
        return self.poll_ticks


# `[bus]` of a drive on Modbus: the link, and the register map that describes the drive.


class Register(Section):
    """`[bus.registers.NAME]`: one value of the drive's register map."""

    address: int = Field(ge=0, le=0xFFFF)
    """zero-based address: 0 is 30001 or 40001 in a manual"""
    table: Literal["input", "holding", "coil", "discrete"]
    """input registers (3xxxx), holding registers (4xxxx), coils (0xxxx) or discrete inputs
    (1xxxx)"""
    type: Literal["uint16", "int16", "uint32", "int32", "float32", "uint64", "int64", "float64"] = (
        "uint16"
    )
    """how the value is coded; 32 bits take two registers, 64 bits four"""
    order: Literal["ABCD", "CDAB", "BADC", "DCBA"] = "ABCD"
    """order of the bytes of two registers, A is the highest: `CDAB` has the low register first,
    `BADC` the low byte of each"""
    scale: Scale = 1.0
    """units per count"""
    unit: str = ""
    """unit of the scaled value, for people"""
    range: Range | None = None
    """a scaled value outside is refused"""
    not_available: int | None = None
    """count or word that means `no value`, such as 0x7F7FFFFF of a float32; all ones (0x8000… when
    signed) when left out"""
    mask: int | None = key(None, ge=1)
    """take these bits alone, such as 0x0F00, as a number from 0 on, or one, such as 0x0008; bits of
    no field are written as 0"""
    names: dict[str, int] = key({})
    """names of its counts, such as { Stop = 0, Run = 1 }"""
    write_limit: int | None = key(None, ge=24)
    """writes a day that the register endures: it is written on change, after its share of a day,
    and for each switch of the bridge"""

    def flaws(self) -> Iterator[Flaw]:
        """Yield what no register has."""
        given, size = self.not_available, 16 * self.words
        if self.end > 0x10000:
            yield Flaw("address", f"{self.address} leaves no room for its registers")
        lowest = 0 if self.type.startswith("uint") else -1 << (size - 1)
        if given is not None and not lowest <= given < 1 << size:
            yield Flaw("not_available", f"{self.type} has no count {given}")
        if self.mask is not None and (self.real or self.mask >> size):
            yield Flaw("mask", f"{self.type} has no bits {self.mask:#x}")
        if self.switches and (self.type != "uint16" or self.mask is not None):
            yield Flaw("type", f"a {self.table} is one bit: leave type and mask out")

    @property
    def words(self) -> int:
        """Registers that the value takes."""
        return {"16": 1, "32": 2, "64": 4}[self.type[-2:]]

    @property
    def real(self) -> bool:
        """True for a floating-point number."""
        return self.type.startswith("float")

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
    """register that the drive advances; while it stands still, no reading is fresh"""
    drive_timeout_s: PositiveFloat | None = key(None, le=2.0)
    """longest time between two advances; one poll when left out"""
    daemon: str | None = None
    """register that the daemon advances with each command"""


class ModbusLink(Answering):
    """Keys of every link to devices on Modbus."""

    device_id: int = key(1, span=(0, 255))
    """device (slave, unit) id; 0 on TCP only"""
    zero_based: bool = False
    """accept addresses that look like labels of a manual: 30001 to 39999, 40001 to 49999"""
    max_gap: int = key(4, span=(0, 123))
    """unmapped registers that a read may run across"""
    max_block: int = key(125, span=(2, 125))
    """registers that the device gives in one reply"""

    @property
    def numbered(self) -> bool:
        """True where each reply has the number of its request."""
        return getattr(self, "framing", "rtu") == "tcp"


class TcpLink(ModbusLink):
    """A link over TCP."""

    host: Host
    """name or address of the device or its gateway"""
    port: int = key(502, span=(1, 65535))
    """port of the device"""
    framing: Literal["tcp", "rtu"] = "tcp"
    """form of the packets; `rtu`: of a serial line, through a plain gateway"""


class RtuLink(ModbusLink):
    """A link over a serial line."""

    device: FilePath
    """serial port, relative to the configuration file"""
    baud: int = key(19200, span=(300, 4_000_000))
    """bits per second"""
    form: Literal["8E1", "8E2", "8O1", "8O2", "8N1", "8N2"] = "8E1"
    """data bits, parity bit (even, odd or none) and stop bits of a character"""

    def flaws(self) -> Iterator[Flaw]:
        """Yield an id that no device has."""
        if self.device_id == 0:
            yield Flaw("device_id", "0 is all devices of a serial line, and none of them replies")

    @property
    def parity(self) -> str:
        """Parity bit: E, O or N."""
        return self.form[1]

    @property
    def stop_bits(self) -> int:
        """Stop bits."""
        return int(self.form[2])


class ModbusBus(PolledBus, ModbusLink):
    """Keys of `[bus]` for every kind of Modbus."""

    write: Literal["multiple", "single", "with-read"] = "multiple"
    """write registers together (function 16), each alone (function 6), or in one exchange with the
    read (function 23)"""
    command_interval_s: float = key(0.0, span=(0.0, 3600.0))
    """longest time between writes of an unchanged command; 0: with each poll"""
    heartbeat: Heartbeat = Field(default_factory=Heartbeat)
    registers: dict[str, Register] = key({})
    """register map, by name"""


class ModbusTcp(ModbusBus, TcpLink):
    """`[bus]` with `type = "modbus-tcp"`."""

    type: Literal["modbus-tcp"]
    """kind of bus"""


class ModbusRtu(ModbusBus, RtuLink):
    """`[bus]` with `type = "modbus-rtu"`."""

    type: Literal["modbus-rtu"]
    """kind of bus"""


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
    """question, as `MEAS:VOLT?`"""
    write: str | None = key(None, pattern=r"^[!-~][ -~]*$")
    """command with a Python format, as `VOLT {:.3f}`"""
    reply: str = "(.*)"
    """regular expression of a whole reply, the value as its one group: `V1 (.*)V`, or the third of
    a list, `(?:[^,]*,){2}([^,]*).*`"""
    answer: str | None = None
    """regular expression of the line with which the supply answers the command, such as `OK`; it
    answers with none when left out"""
    form: Literal["real", "integer", "hexadecimal"] = "real"
    """form of the number: an `integer` has no sign here, and text may follow, as of `SYST:ERR?`;
    one with `0x` or `#H` before it is hexadecimal in any case; `integer` where there are `names` or
    a `mask`"""
    mask: int | None = key(None, span=(1, 0xFFFF_FFFF))
    """bits that are taken of a word, as one number"""
    unit: str = ""
    """unit of the value, for people"""
    range: Range | None = None
    """a value outside is refused"""
    names: dict[str, int] = key({})
    """words for numbers, such as { OFF = 0, ON = 1 }"""

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
        if self.mask is not None and self.write is not None:
            yield Flaw("mask", "is for a value that is read alone: `write` sets the word")

    @property
    def whole(self) -> bool:
        """True for a whole number."""
        return self.form != "real" or bool(self.mask or self.names)

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
        found, bare = _WHOLE.fullmatch(text), 16 if self.form == "hexadecimal" else 10
        base = bare if found is None else _BASES.get((found[1] or "").lower(), bare)
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
            mask=self.mask,
        )


class ScpiBus(PolledBus):
    """`[bus]` with `type = "scpi"`."""

    type: Literal["scpi"]
    """kind of bus"""
    host: Host
    """name or address of the device or its gateway"""
    port: int = key(5025, span=(1, 65535))
    """port of the device"""
    line_end: Literal["LF", "CR", "CRLF"] = "LF"
    """end of each line that is sent; its last character ends each reply, too"""
    done: str = key("*OPC?", pattern=r"^([!-~][ -~]*\?)?$")
    """question after each command: `*OPC?` must give 1, another one any reply; `""`: no command is
    confirmed but by its `answer`"""
    values: dict[str, ScpiValue] = key({}, max_length=1000)
    """values, by name; set in this order"""

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
