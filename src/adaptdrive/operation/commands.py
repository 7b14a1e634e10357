"""From the payload of a command to a request, or to a reason why there is none.

Reading goes in two steps, so that a malformed command can be answered: first whatever is there
is read for its id, then the whole is held against the one shape that its verb allows. Whether a
number lies in the drive's range is for the host to say, which knows the limits.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from datetime import datetime
from typing import Annotated, Any, Literal

import msgspec

from adaptdrive.control.signals import Mode
from adaptdrive.control.waveform import Shape, Waveform
from adaptdrive.errors import RefusedError
from adaptdrive.runtime.requests import (
    Disable,
    Enable,
    Request,
    Reset,
    SetMode,
    SetPole,
    SetSetpoint,
    SetVoltage,
    SetWaveform,
)

LONGEST_PAYLOAD = 8192
LONGEST_ID = 128
LONGEST_USER = 128

_SURROGATE = re.compile("[\ud800-\udfff]")
_ID = re.compile(r'"id"\s*:\s*("(?:[^"\\\x00-\x1f]|\\.)*")')


class _Envelope(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    id: Annotated[str, msgspec.Meta(min_length=1, max_length=LONGEST_ID)]
    expires: Annotated[datetime, msgspec.Meta(tz=True)] | None = None
    user: Annotated[str, msgspec.Meta(max_length=LONGEST_USER)] | None = None


class _Number(_Envelope, frozen=True):
    value: float


class _ModeName(_Envelope, frozen=True):
    value: Mode


class _Waveform(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    shape: Shape
    low: float
    high: float
    period_s: float


class _WaveformOrOff(_Envelope, frozen=True):
    value: _Waveform | Literal["off"] | None


class _Voltage(_Envelope, frozen=True):
    value: float
    hold_s: float | None = None


class _Plain(_Envelope, frozen=True):
    value: None = None


_Form = _Number | _ModeName | _WaveformOrOff | _Voltage | _Plain

_VERBS: dict[str, tuple[type[_Form], Callable[[Any], Request]]] = {
    "setpoint": (_Number, lambda form: SetSetpoint(_finite("value", form.value))),
    "waveform": (_WaveformOrOff, lambda form: SetWaveform(_waveform(form.value))),
    "mode": (_ModeName, lambda form: SetMode(form.value)),
    "voltage": (_Voltage, lambda form: _voltage(form)),  # noqa: PLW0108 - defined below
    "enable": (_Plain, lambda _: Enable()),
    "disable": (_Plain, lambda _: Disable()),
    "reset": (_Plain, lambda _: Reset()),
    "pole": (_Number, lambda form: SetPole(_finite("value", form.value))),
}
"""Shape of the payload of each verb, and the request that a filled one makes."""

VERBS = tuple(_VERBS)
STOP = "disable"
"""The verb that is carried out at its arrival, whatever its payload says."""


class Payload:
    """The payload of a command as it came, read as far as it can be.

    Attributes:
        id: The id, None where none can be read; a number where one was sent in its place.
    """

    def __init__(self, raw: bytes) -> None:
        self._document: object = None
        self._flaw = ""
        try:
            self._document = _read(raw)
        except RefusedError as problem:
            self._flaw = problem.reason
        self.id = _salvaged_id(raw) if self._flaw else _id_of(self._document)

    @property
    def value(self) -> str:
        """The value asked for, as JSON; empty where there is none."""
        value = self._field("value")
        return "" if value is None else json.dumps(value, ensure_ascii=False)

    @property
    def user(self) -> str:
        """Name that the sender gives itself, unverified."""
        user = self._field("user")
        return user[:LONGEST_USER] if isinstance(user, str) and user.isprintable() else ""

    def _field(self, name: str) -> Any:  # noqa: ANN401 - whatever was sent
        return self._document.get(name) if isinstance(self._document, dict) else None

    def request(self, verb: str) -> tuple[Request, datetime | None]:
        """Return the request of a command and its expiry.

        Args:
            verb: Last part of the topic.

        Raises:
            RefusedError: The payload is malformed, or the verb is not known.
        """
        if verb not in _VERBS:
            raise RefusedError(f"unknown verb {verb!r}; known are {', '.join(VERBS)}")
        if self._flaw:
            raise RefusedError(self._flaw)
        form, make = _VERBS[verb]
        try:
            filled = msgspec.convert(self._document, form)
        except msgspec.ValidationError as problem:
            raise RefusedError(str(problem).replace("`$.", "`")) from problem
        except UnicodeError as problem:
            raise RefusedError("text with a lone surrogate") from problem
        return make(filled), filled.expires


def _read(raw: bytes) -> object:
    """Read JSON; NaN and infinities pass, to be refused by name and with their id."""
    if len(raw) > LONGEST_PAYLOAD:
        raise RefusedError(f"payload of {len(raw)} bytes; at most {LONGEST_PAYLOAD} are read")
    try:
        document: object = json.loads(raw.decode("utf-8"))
    except (ValueError, RecursionError) as problem:
        raise RefusedError(f"not JSON: {problem}") from problem
    return document


def _id_of(document: object) -> str | int | None:
    found = document.get("id") if isinstance(document, dict) else None
    if isinstance(found, bool) or not isinstance(found, str | int):
        return None
    return found if _can_be_sent(found) else None


def _salvaged_id(raw: bytes) -> str | None:
    match = _ID.search(raw[:LONGEST_PAYLOAD].decode("utf-8", "replace"))
    try:
        found = json.loads(match[1]) if match else None
    except ValueError:
        return None
    return found if isinstance(found, str) and _can_be_sent(found) else None


def _can_be_sent(found: str | int) -> bool:
    """False for what a JSON text cannot carry back: lone surrogates, numbers beyond 64 bit."""
    if isinstance(found, int):
        return -(2**63) <= found < 2**63
    return not _SURROGATE.search(found)


def _waveform(form: _Waveform | Literal["off"] | None) -> Waveform | None:
    if not isinstance(form, _Waveform):
        return None
    return Waveform(
        shape=form.shape,
        low=_finite("value.low", form.low),
        high=_finite("value.high", form.high),
        period_s=_finite("value.period_s", form.period_s),
    )


def _voltage(form: _Voltage) -> SetVoltage:
    hold_s = None if form.hold_s is None else _finite("hold_s", form.hold_s)
    return SetVoltage(_finite("value", form.value), hold_s)


def _finite(place: str, value: float) -> float:
    if not math.isfinite(value):
        raise RefusedError(f"{place} = {value} is not a finite number")
    return value


def payload_type(verb: str) -> type[_Form]:
    """Return the shape of the payload of a verb."""
    return _VERBS[verb][0]
