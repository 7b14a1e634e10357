"""`[bus]` of a supply that speaks SCPI, lines of text over TCP, and the values behind them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Literal

from adaptdrive.config.bus import PolledBus, TcpHost
from adaptdrive.config.modbus import ModbusTcp, Register, RegisterRange
from adaptdrive.config.section import Section, key
from adaptdrive.util.errors import Flaw

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
