"""From the payload of a command to a request, or to a reason why there is none.

Reading goes in two steps, so that a malformed command can be answered: first whatever is there
is read for its id, then the whole is held against the one shape that its verb allows. Whether a
number lies in the drive's range is checked by the host, which has the limits.
"""

import json
import math
import re
from collections.abc import Collection, Mapping
from dataclasses import MISSING, fields
from datetime import datetime, timedelta
from typing import Annotated, Any, Literal, Protocol, get_type_hints

import msgspec

from adaptdrive.control.signals import Shape, Waveform
from adaptdrive.runtime.reports import State
from adaptdrive.runtime.requests import REQUESTS, Disable, Request
from adaptdrive.safety.trips import Trip
from adaptdrive.util.errors import RefusedError
from adaptdrive.util.quantity import BOOST, Display, Given

# From the payload of a command to a request, or to a reason why there is none.

LONGEST_PAYLOAD = 16_384  # a program of 100 steps
LONGEST_ID = 128
LONGEST_USER = 128

_SURROGATE = re.compile("[\ud800-\udfff]")
_ID = re.compile(r'"id"\s*:\s*("(?:[^"\\\x00-\x1f]|\\.)*")')


_Expires = Annotated[datetime, msgspec.Meta(tz=True)] | None


class _Plain(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    value: None = None
    id: Annotated[str, msgspec.Meta(min_length=1, max_length=LONGEST_ID)]
    expires: _Expires = None
    user: Annotated[str, msgspec.Meta(max_length=LONGEST_USER)] | None = None


_ENVELOPE = set(_Plain.__struct_fields__)


class _Waveform(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    shape: Shape
    low: float
    high: float
    period_s: float


STOP = Disable.verb
"""The verb that is carried out at its arrival, whatever its payload is."""

PING = "ping"
"""The verb that changes nothing: its answer shows that the sender may command the drive."""


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
        """The value asked for, its unit and its further fields; empty where there are none."""
        sent = dict(self._document) if isinstance(self._document, dict) else {}
        value, unit = sent.get("value"), sent.pop("unit", None)
        further = {k: v for k, v in sent.items() if k not in _ENVELOPE and v is not None}
        text = "" if value is None else json.dumps(value, ensure_ascii=False)
        text += f" {unit}" if text and isinstance(unit, str) else ""
        return f"{text} {json.dumps(further, ensure_ascii=False)}".strip() if further else text

    @property
    def user(self) -> str:
        """Name that the sender gives itself, unverified."""
        user = self._field("user")
        return user[:LONGEST_USER] if isinstance(user, str) and user.isprintable() else ""

    @property
    def expires(self) -> datetime | None:
        """Time at which it ends, whatever else is wrong with it; None where none can be read."""
        try:
            expires: datetime | None = msgspec.convert(self._field("expires"), _Expires)
        except (msgspec.ValidationError, UnicodeError):
            return None
        return expires

    def asked(self, verb: str) -> str | None:
        """Return the content of a command without its verb, as JSON; None where it is malformed."""
        try:
            request, _ = self.request(verb)
        except RefusedError:
            return None
        return msgspec.json.encode(request).decode()

    def _field(self, name: str) -> Any:  # noqa: ANN401 - whatever was sent
        return self._document.get(name) if isinstance(self._document, dict) else None

    def request(self, verb: str) -> tuple[Request, datetime | None]:
        """Return the request of a command and its expiry.

        Args:
            verb: Last part of the topic.

        Raises:
            RefusedError: The payload is malformed, or the verb is not known.
        """
        if verb not in REQUESTS:
            raise RefusedError(f"unknown verb {verb!r}; known are {', '.join((*REQUESTS, PING))}")
        if self._flaw:
            raise RefusedError(self._flaw)
        kind = REQUESTS[verb]
        try:
            filled: Any = msgspec.convert(self._document, FORMS[verb])
        except msgspec.ValidationError as problem:
            raise RefusedError(str(problem).replace("`$.", "`")) from problem
        except UnicodeError as problem:
            raise RefusedError("text with a lone surrogate") from problem
        values = {one.name: _value(one.name, getattr(filled, one.name)) for one in fields(kind)}
        return kind(**values), filled.expires


def _read(raw: bytes) -> object:
    """Read JSON; NaN and infinities pass, to be refused by name and with their id."""
    if len(raw) > LONGEST_PAYLOAD:
        raise RefusedError(f"payload of {len(raw)} bytes; at most {LONGEST_PAYLOAD} are read")
    try:
        document: object = json.loads(raw.decode("utf-8"), object_pairs_hook=_once)
    except (ValueError, RecursionError) as problem:
        raise RefusedError(f"not JSON: {problem}") from problem
    return document


def _once(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """Return an object whose keys are all there once: readers differ in which of two values counts.

    Raises:
        RefusedError: One is there twice.
    """
    document: dict[str, object] = {}
    for name, value in pairs:
        if name in document:
            raise RefusedError(f"the key {name!r} is there twice")
        document[name] = value
    return document


def _id_of(document: object) -> str | int | None:
    """Return the id, None for what JSON cannot carry back: lone surrogates, and beyond 64 bit."""
    found = document.get("id") if isinstance(document, dict) else None
    if isinstance(found, str):
        return None if _SURROGATE.search(found) else found
    if isinstance(found, bool) or not isinstance(found, int):
        return None
    return found if -(2**63) <= found < 2**63 else None


def _salvaged_id(raw: bytes) -> str | int | None:
    match = _ID.search(raw[:LONGEST_PAYLOAD].decode("utf-8", "replace"))
    try:
        return _id_of(json.loads(f"{{{match[0]}}}")) if match else None
    except ValueError:
        return None


def _form(kind: type[Request]) -> type[msgspec.Struct]:
    """Return the shape of the payload of a request: the envelope and its fields."""
    hints = get_type_hints(kind)
    members = [
        (
            one.name,
            _AS_SENT.get(hints[one.name], hints[one.name]),
            msgspec.NODEFAULT if one.default is MISSING else one.default,
        )
        for one in fields(kind)
    ]
    return msgspec.defstruct(kind.verb, members, bases=(_Plain,), frozen=True, kw_only=True)


def _value(place: str, sent: Any) -> Any:  # noqa: ANN401 - as the request declares it
    if isinstance(sent, float):
        return _finite(place, sent)
    if isinstance(sent, _Waveform):
        levels = {name: _finite(f"{place}.{name}", getattr(sent, name)) for name in _LEVELS}
        return Waveform(shape=sent.shape, **levels)
    return None if sent == _OFF and place == "value" else sent


def _finite(place: str, value: float) -> float:
    if not math.isfinite(value):
        raise RefusedError(f"{place} = {value} is not a finite number")
    return value


_OFF = "off"
_LEVELS = ("low", "high", "period_s")
_AS_SENT: dict[object, object] = {Waveform | None: _Waveform | Literal["off"] | None}
"""Shapes of fields in the payload, where they differ from those of the request."""

FORMS: dict[str, type[msgspec.Struct]] = {
    **{verb: _form(kind) for verb, kind in REQUESTS.items()},
    PING: msgspec.defstruct(PING, [], bases=(_Plain,), frozen=True, kw_only=True),
}
"""Shape of the payload of each verb."""


# What carries requests out.


class Host(Protocol):
    """The running drive, as far as operators are concerned."""

    async def execute(self, request: Request) -> State:
        """Carry out a request between two ticks.

        Returns:
            The state after it.

        Raises:
            RefusedError: The request cannot be carried out; nothing was changed.
        """

    def trip(self, cause: Trip) -> None:
        """Trip at once for a cause outside the drive; the first cause stays until `reset`."""

    def stop(self) -> State:
        """Bring the drive into its safe state at once, in every state and at any time.

        It neither waits nor refuses.

        Returns:
            The state after it.
        """


# Payloads for people: read with care, as every client may publish, and names of estimates.

_LONGEST_S = 1e9
"""Least time that no program has."""

_LARGEST = 1e100
"""Least number that no quantity has: sums and differences of smaller ones are numbers still."""


def part(content: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return a part of a payload that is an object; empty where it is missing or something else.

    Every client of the broker that may publish there decides what a payload holds.
    """
    found = content.get(name)
    return found if isinstance(found, dict) else {}


def number(value: object) -> float:
    """Return a number in a payload as a float, NaN for anything else and where it is too large."""
    if not isinstance(value, int | float) or not abs(value) < _LARGEST:
        return math.nan
    return float(value)


def printable(value: object) -> str:
    """Return a part of a payload as text without characters that command a terminal."""
    return "".join(letter if letter.isprintable() else "?" for letter in str(value))


def given_in(state: Mapping[str, Any]) -> Given:
    """Return what a drive is commanded, and gives, from the payload of `state`."""
    found = part(state, "manipulated")
    return Given(*(printable(found.get(name, getattr(BOOST, name))) for name in ("name", "unit")))


def display_in(state: Mapping[str, Any]) -> Display:
    """Return the unit in which people see and type the output, from the payload of `state`."""
    output = part(state, "output")
    found = part(output, "display")
    own, unit = (printable(one.get("unit") or "") for one in (output, found))
    display = Display(unit, number(found.get("scale")), number(found.get("offset")))
    return display if display.scale > 0.0 and math.isfinite(display.offset) else Display(own)


def program_text(state: Mapping[str, Any], drive: Mapping[str, Any]) -> str:
    """Return the program that runs, or has run last, in words; empty before the first.

    Args:
        state: Payload of `state`.
        drive: Payload of `telemetry/drive`.
    """
    text, left_s = part(state, "program").get("text"), number(drive.get("remaining_s"))
    left = f", {timedelta(seconds=round(left_s))} left" if 0.0 <= left_s < _LONGEST_S else ""
    return f"{printable(text)}{left}" if text else ""


def unconfirmed_stop(state: Mapping[str, Any]) -> str:
    """Return the value of `stop` for a stop that the drive has not confirmed, empty for none.

    A drive may be energised then although it is commanded off.

    Args:
        state: Payload of `state`.
    """
    word = state.get("stop")
    return "" if word is None or word == "confirmed" else printable(word)


_UNIT = re.compile(r"(.+?)_((?:s|V|A|W|K|S|J|F|Ohm|rad)\d?(?:_per_(?:s|V|A|W|K)\d?)?)")
_WRITTEN = (("_per_", "/"), ("2", "²"), ("Ohm", "Ω"))
_BATH = "resistance_K_per_W"
OFFSET = "input_offset"
"""Name of an estimate that may well be 0: no deviation makes it unknown."""


def is_known(estimate: Mapping[str, Any]) -> bool:
    """Return whether an estimate is larger than two of its standard deviations.

    Args:
        estimate: Its `value` and `std`; one without a deviation counts as known.
    """
    return not 2.0 * number(estimate.get("std")) >= abs(number(estimate.get("value")))


def quantity_and_unit(
    name: str, names: Collection[str], output_unit: str, given_unit: str = "V"
) -> tuple[str, str]:
    """Return the quantity that an estimate is, and its unit.

    Args:
        name: Name of the estimate, such as `tau_sum_s`.
        names: Names of all estimates of the load: an offset has the unit of the load's input.
        output_unit: Unit of the output, of which a gain is so much for each unit of the input.
        given_unit: Unit of what the drive gives, which is the input of a motor.
    """
    if name == "gain":
        one = f"({output_unit})" if "/" in output_unit else output_unit or "1"
        return name, f"{one}/{given_unit}" if given_unit else output_unit
    if name == OFFSET:
        return "input offset", "W" if _BATH in names else given_unit
    match = _UNIT.fullmatch(name)
    if match is None:
        return name.replace("_", " "), ""
    unit = match[2]
    for word, sign in _WRITTEN:
        unit = unit.replace(word, sign)
    return match[1].replace("_", " "), unit
