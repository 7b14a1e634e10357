"""Signals of a DBC, as candidates for the quantities of a configuration."""

from __future__ import annotations

import re
from collections.abc import Iterator

from cantools.database.can.database import Database
from cantools.database.can.message import Message
from cantools.database.can.signal import Signal

from adaptdrive.config.units import known_unit
from adaptdrive.hardware.proposal import Candidate

_COMMANDING = re.compile(r"cmd|command|ctrl|control|set|req|host|order", re.IGNORECASE)
_ALIVE = re.compile(r"alive|rolling|heartbeat|count|cnt|seq", re.IGNORECASE)
_CHECKSUM = re.compile(r"crc|checksum|chk", re.IGNORECASE)


def candidates(database: Database) -> Iterator[Candidate]:
    """Yield every signal that may be a quantity."""
    for message in database.messages:
        commanded = _COMMANDING.search(message.name) is not None
        for signal in message.signals:
            if not (signal.is_multiplexer or _is_alive(signal) or _is_checksum(signal)):
                yield _candidate(message, signal, commanded=commanded)


def proofs(message: Message) -> tuple[str | None, str | None]:
    """Return the signals that look like the alive counter and the checksum of a message."""
    counter = next((s.name for s in message.signals if _is_alive(s)), None)
    checksum = next((s.name for s in message.signals if _is_checksum(s)), None)
    return counter, checksum


def _candidate(message: Message, signal: Signal, *, commanded: bool) -> Candidate:
    low, high = signal.minimum, signal.maximum
    limits = "" if low is None or high is None or low == high else f"{low:g}…{high:g}"
    written = "".join(one for one in signal.unit or "" if one.isprintable())
    return Candidate(
        reference=f"{message.name}.{signal.name}",
        words=f"{message.name}.{signal.name}",
        unit=known_unit(written) or written,
        range=limits,
        commanded=commanded,
        names=tuple(str(name) for name in (signal.choices or {}).values()),
        bits=signal.length,
    )


def _is_alive(signal: Signal) -> bool:
    return signal.length <= 8 and _ALIVE.search(signal.name) is not None


def _is_checksum(signal: Signal) -> bool:
    return signal.length == 8 and _CHECKSUM.search(signal.name) is not None
