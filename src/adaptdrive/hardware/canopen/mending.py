"""Lines of an EDS that its parser refuses, although nothing may use them.

An object that cannot be mended is left out, so that it is an error only for who names it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

_SECTION = re.compile(r"\s*\[([^\]]*)\]")
_OBJECT = re.compile(r"([0-9A-F]{4})(?:(sub)([0-9A-F]+)|(name))?", re.IGNORECASE)
_OCTAL = re.compile(r"^\+?0+(?=[0-7]+$)")
_PADDED = re.compile(r"^\+?0*(?=\d+$)")
_NUMBERS = ("ObjectType", "DataType", "PDOMapping", "NrOfEntries")
_GROUPS = (8, 9)
"""Types of objects that have members: arrays and records (CiA 306)."""

_NAME = "ParameterName"
_UNUSED = ("comments", "dummyusage", "devicecomissioning")
_IDENTITY = ("VendorNumber", "ProductNumber")
"""All that is used of a device."""

_MORE = ("AccessType", "CompactSubObj", "LowLimit", "HighLimit", "DefaultValue")
_KEYS = {one.lower(): one for one in (*_NUMBERS, *_IDENTITY, *_MORE, _NAME)}
"""Names of entries as the parser knows them."""


@dataclass(slots=True)
class _Part:
    """A section: its name, its line, and its entries."""

    name: str
    line: int
    entries: dict[str, str] = field(default_factory=dict)


def mended(text: str) -> tuple[str, list[str]]:
    """Return a text in which the parser finds no flaws, and remarks on them with their lines.

    Args:
        text: Text of an EDS or DCF.
    """
    remarks: list[str] = []
    kept: dict[str, _Part] = {}
    for part in _parts(text, remarks):
        problem = "is there twice" if part.name.lower() in kept else _flaw_of(part, kept)
        if problem:
            remarks.append(f"line {part.line}: [{part.name}] is left out: it {problem}")
        elif part.name.lower() not in _UNUSED:
            kept[part.name.lower()] = part
    kept.setdefault("deviceinfo", _Part("DeviceInfo", 0))
    sections = (f"[{one.name}]\n{_written(one)}" for one in kept.values())
    return "\n".join(sections), remarks


def _parts(text: str, remarks: list[str]) -> list[_Part]:
    """Return the sections of a text; an entry without a value is left out, as is what is none."""
    parts: list[_Part] = []
    for number, line in enumerate(text.split("\n"), 1):
        head = _SECTION.match(line)
        key, sign, value = (one.strip() for one in line.partition("="))
        value = value.partition(" ;")[0].strip()
        if head:
            parts.append(_Part(_section(head[1].strip()), number))
        elif not line.strip() or line.lstrip()[0] in ";#":
            continue
        elif not (key and sign and parts):
            remarks.append(f"line {number}: {line.strip()[:60]!r} is no entry")
        elif value:
            key = _KEYS.get(key.lower(), key)
            parts[-1].entries.setdefault(key, value if key == _NAME else _spelt(value))
    return parts


def _section(name: str) -> str:
    """Return the name of a section as the parser knows it, from any case."""
    found = _OBJECT.fullmatch(name)
    if found is None:
        return "DeviceInfo" if name.lower() == "deviceinfo" else name
    return f"{found[1]}sub{found[3]}" if found[2] else f"{found[1]}{'Name' if found[4] else ''}"


def _spelt(value: str) -> str:
    """Return a number as Python writes it, and each other value as it is."""
    return _PADDED.sub("", _OCTAL.sub("0o", value))


def _flaw_of(part: _Part, kept: dict[str, _Part]) -> str | None:
    """Return why a section cannot be used, None where it can."""
    entries, found = part.entries, _OBJECT.fullmatch(part.name)
    if part.name == "DeviceInfo":
        given = {key: entries[key] for key in _IDENTITY if key in entries}
        part.entries = {key: value for key, value in given.items() if _is_number(value)}
    if found is None:
        return None
    for key in _NUMBERS:
        if key in entries and not _is_number(entries[key]):
            return f"has {key} = {entries[key]!r}"
    if (found[2] or found[4]) and found[1].lower() not in kept:
        return f"belongs to the object {found[1]}, which is not there"
    if found[4]:
        return None if "NrOfEntries" in entries else "has no NrOfEntries"
    entries.setdefault(_NAME, f"0x{found[1]}{'.' if found[3] else ''}{found[3] or ''}")
    grouped = int(entries.get("ObjectType", "7"), 0) in _GROUPS and "CompactSubObj" not in entries
    needed = () if grouped else ("DataType", "AccessType")
    return next((f"has no {key}" for key in needed if key not in entries), None)


def _is_number(value: str) -> bool:
    """Return whether a value is a number as Python writes it."""
    try:
        int(value, 0)
    except ValueError:
        return False
    return True


def _written(part: _Part) -> str:
    return "".join(f"{key}={value}\n" for key, value in part.entries.items())
