"""`[bus]` of a supply that speaks SCPI, lines of text over TCP, and the values behind them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Literal

from adaptdrive.config.bus import PolledBus, TcpHost
from adaptdrive.config.modbus import ModbusTcp, Register, RegisterRange
from adaptdrive.config.section import Section, key
from adaptdrive.errors import Flaw

_STEP = 8
"""Registers from one value to the next: four hold it, and a gap keeps requests apart."""

_REAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([Ee][+-]?\d+)?", re.ASCII)
_WHOLE = re.compile(r"[+-]?(\d+)(,.*)?", re.ASCII)


class ScpiValue(Section):
    """`[bus.values.NAME]`: one value of the supply, and the lines that ask for it and set it."""

    query: str | None = key(None, pattern=r"^[!-~][ -~]*\?[ -~]*$")
    write: str | None = key(None, pattern=r"^[!-~][ -~]*$")
    reply: str = "(.*)"
    integer: bool = False
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
            groups = re.compile(self.reply).groups
        except re.error as problem:
            yield Flaw("reply", f"{self.reply!r} is no regular expression: {problem}")
        else:
            if groups != 1:
                yield Flaw("reply", f"{self.reply!r} has {groups} groups: one is the value")

    @property
    def whole(self) -> bool:
        """True for a whole number."""
        return self.integer or bool(self.names)

    def line(self, number: float) -> str:
        """Return the command for a number.

        Args:
            number: A finite value in the unit of the supply.
        """
        words = (name for name, one in self.names.items() if one == number)
        return (self.write or "").format(next(words, number))

    def number(self, reply: str) -> float:
        """Return the number that a reply stands for, NaN for none.

        Args:
            reply: The line without its end.
        """
        part = re.fullmatch(self.reply, reply)
        text = part[1].strip() if part else ""
        if text in self.names:
            return self.names[text]
        found = (_WHOLE if self.whole else _REAL).fullmatch(text)
        return float(found[self.whole]) if found else math.nan

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
        )


class ScpiBus(PolledBus, TcpHost):
    """`[bus]` with `type = "scpi"`."""

    type: Literal["scpi"]
    port: int = key(5025, span=(1, 65535))
    done: str = key("*OPC?", pattern=r"^([!-~][ -~]*\?)?$")
    values: dict[str, ScpiValue] = key({}, max_length=1000)

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
