"""Reading a configuration file, with every flaw named by its place."""

import contextlib
import hashlib
import re
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import TypeAdapter, ValidationError

from adaptdrive.config.consistency import consistency_flaws
from adaptdrive.config.root import Configuration
from adaptdrive.util.errors import ConfigurationError, Flaw, key_proposal

_TYPE_AT = {"load": 1, "bus": 1, "sensor_bus": 2}
_MESSAGES = {"extra_forbidden": "Unknown key", "union_tag_not_found": "Field required"}
_UNKNOWN = "extra_forbidden"
_ALL = frozenset(Configuration.model_fields)
_LARGEST = 1e12
"""No quantity in SI units, factor or bound is larger, or smaller than its inverse."""

_INTEGER_BITS = 64
_LONGEST_TEXT = 4096
"""The longest path of Linux. Names and units go into every message of telemetry."""
_DEEPEST = 20
_CONTROLS = re.compile(r"[\0-\x1f\x7f-\x9f\u2028\u2029]")
"""Control characters, and the separators of lines and paragraphs of Unicode."""

_LONGEST = 1_000_000
"""Fifty times the longest example; a device or a pipe may never end."""

Keys = tuple[int | str, ...]


Findings = tuple[Configuration, frozenset[str], tuple[Flaw, ...]]
"""Contents of a file as far as they are valid: its sections, and the names of those that are valid,
if need be without their flawed keys; the others are missing. And everything that is wrong so far.
"""


def load_configuration(path: Path) -> Configuration:
    """Read and validate one TOML file; relative paths in it are taken from its folder.

    Args:
        path: The file.

    Returns:
        The configuration, whole and consistent.

    Raises:
        ConfigurationError: The file cannot be read, or holds flaws; all of them are listed.
    """
    return parse_configuration(read_text(path), path)


def read_text(path: Path) -> str:
    """Return the text of a configuration file, which may be a pipe: its writer is waited for.

    Args:
        path: The file.

    Raises:
        ConfigurationError: The file cannot be read, is no text or has too many characters.
    """
    try:
        with path.open(encoding="utf-8-sig") as file:
            text = file.read(_LONGEST + 1)
    except (OSError, ValueError) as problem:
        raise ConfigurationError(path, [Flaw("file", str(problem))]) from problem
    if len(text) > _LONGEST:
        raise ConfigurationError(path, [Flaw("file", f"it has more than {_LONGEST} characters")])
    return text


def digest_of(text: str) -> str:
    """Return what tells a text of a configuration from every other: its SHA-256."""
    return hashlib.sha256(text.encode()).hexdigest()


def find_flaws(text: str, source: Path) -> Findings:
    """Examine the text of a configuration, and continue behind its flaws.

    Args:
        text: The text.
        source: The file that it came from.

    Raises:
        ConfigurationError: The text is no TOML.
    """
    return _examine(read_tables(text, source), source.parent)


def parse_configuration(text: str, source: Path) -> Configuration:
    """Validate the text of a configuration that came from (or belongs beside) `source`.

    Raises:
        ConfigurationError: As for `load_configuration`.
    """
    return validate_configuration(read_tables(text, source), source)


def validate_configuration(tables: dict[str, Any], source: Path) -> Configuration:
    """Validate the tables of a configuration that came from (or belongs beside) `source`.

    Flawed values are taken out of them.

    Raises:
        ConfigurationError: As for `load_configuration`.
    """
    configuration, _, flaws = _examine(tables, source.parent)
    if flaws:
        raise ConfigurationError(source, flaws)
    return configuration


def read_tables(text: str, source: Path) -> dict[str, Any]:
    """Return the tables of a text that came from `source`.

    Raises:
        ConfigurationError: The text is no TOML.
    """
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as problem:  # of a syntax error, or of absurd nesting
        raise ConfigurationError(source, [Flaw("TOML", str(problem))]) from problem


def _examine(tables: dict[str, Any], folder: Path) -> Findings:
    """Validate tables; what is wrong is taken out of them, and the rest is examined further.

    A section with a wrong value is not compared with others: a default stands in for that value.
    """
    wrong = dict(_value_flaws(tables))
    for place in wrong:
        _take_out(tables, place)
    flaws = tuple(Flaw(".".join(map(str, place)), why) for place, why in wrong.items())
    doubtful: set[str] = set()
    try:
        whole, valid = Configuration.model_validate(tables, context=folder), _ALL
    except ValidationError as problem:
        errors: list[dict[str, Any]] = [{**error} for error in problem.errors(include_url=False)]
        flaws = added(flaws, map(_flaw, errors))
        for error in errors:
            _take_out(tables, _location(error["loc"]))
        doubtful = {str(error["loc"][0]) for error in errors if error["type"] != _UNKNOWN}
        sections = _valid_sections(tables, folder)
        whole, valid = Configuration.model_construct(None, **sections), frozenset(sections)
    return whole, valid, added(flaws, consistency_flaws(whole, valid - doubtful))


def added(flaws: Sequence[Flaw], more: Iterable[Flaw]) -> tuple[Flaw, ...]:
    """Return flaws and those of more places; a second one of a place follows from the first.

    Args:
        flaws: What is known to be wrong.
        more: What was found then.
    """
    known = {flaw.place for flaw in flaws}
    return (*flaws, *(one for one in more if one.place not in known))


def _valid_sections(tables: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the sections that are valid each by itself, defaults included."""
    found = {}
    for name, field in Configuration.model_fields.items():
        if name in tables:
            section: Any = Annotated[field.annotation, field]
            with contextlib.suppress(ValidationError):
                found[name] = TypeAdapter(section).validate_python(tables[name], context=folder)
        elif not field.is_required():
            found[name] = field.get_default(call_default_factory=True)
    return found


def _flaw(error: dict[str, Any]) -> Flaw:
    keys = tuple(str(key) for key in _location(error["loc"]))
    place = ".".join(keys)
    message = _MESSAGES.get(error["type"], error["msg"]).removeprefix("Value error, ")
    if error["type"] == _UNKNOWN:
        location = tuple(str(part) for part in error["loc"])
        return Flaw(place, message + key_proposal(_schema(), location, keys))
    if error["type"].startswith("union_tag"):
        place = f"{place}.type"
    value = error["input"]
    if isinstance(value, str | int | float | bool) and repr(value) not in message:
        message = f"{message} (it is {_shortened(repr(value))})"
    return Flaw(place, message)


@cache
def _schema() -> dict[str, Any]:
    return Configuration.model_json_schema()


def _location(location: Keys) -> Keys:
    """The keys; pydantic counts a type of load or bus as a separate table."""
    at = _TYPE_AT.get(str(location[0]), len(location))
    return (*location[:at], *location[at + 1 :])


def _value_flaws(value: object, keys: Keys = ()) -> Iterator[tuple[Keys, str]]:
    """Find numbers that nothing has, and texts and keys that no screen, log or topic can show."""
    if len(keys) > _DEEPEST:
        yield keys, f"more than {_DEEPEST} tables lie in each other"
    elif isinstance(value, dict):
        for key, one in value.items():
            yield from _text_flaws(key, "the key", (*keys, key)) or _value_flaws(one, (*keys, key))
    elif isinstance(value, list):
        for number, one in enumerate(value):
            yield from _value_flaws(one, (*keys, number))
    elif isinstance(value, str):
        yield from _text_flaws(value, "the text", keys)
    else:
        yield from _number_flaws(value, keys)


def _text_flaws(text: str, what: str, keys: Keys) -> list[tuple[Keys, str]]:
    if len(text) > _LONGEST_TEXT:
        rule = f"have at most {_LONGEST_TEXT} characters"
    elif _CONTROLS.search(text):
        rule = "be one line without control characters"
    else:
        return []
    return [(keys, f"{what} must {rule} (it is {_shortened(repr(text))})")]


def _number_flaws(value: object, keys: Keys) -> Iterator[tuple[Keys, str]]:
    if isinstance(value, float) and value and not 1.0 / _LARGEST <= abs(value) <= _LARGEST:
        problem = f"its size must be from {1.0 / _LARGEST:g} to {_LARGEST:g}, in SI units"
        yield keys, f"{problem} (it is {value})"
    elif isinstance(value, int) and value.bit_length() >= _INTEGER_BITS:
        yield keys, f"has more than {_INTEGER_BITS} bits"


def _take_out(tables: Any, place: Keys) -> None:  # noqa: ANN401 - or a list of them
    """Take a value, if it is there, out of tables; one within a list stands for the list."""
    *above, last = place[:-1] if isinstance(place[-1], int) else place
    with contextlib.suppress(LookupError, TypeError, AttributeError):
        for key in above:
            tables = tables[key]
        tables.pop(last, None)


def _shortened(text: str, end: int = 40) -> str:
    """Return a text without its middle, where it is long."""
    return text if len(text) <= 2 * end else f"{text[:end]}…{text[-end:]}"
