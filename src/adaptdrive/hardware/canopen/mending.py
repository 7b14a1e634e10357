"""Lines of an EDS that its parser refuses, although nothing may use them.

An object that cannot be mended is left out, so that it is an error only for who names it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

_SECTION = re.compile(r"\s*\[([^\]]*)\]")
_OBJECT = re.compile(r"([0-9A-Fa-f]{4})(?:([Ss]ub)([0-9A-Fa-f]+)|(Name))?")
_OCTAL = re.compile(r"0([0-7]+)")
_TYPES = ("ObjectType", "DataType")
_NUMBERS = (*_TYPES, "PDOMapping", "LowLimit", "HighLimit", "NrOfEntries")
_GROUPS = (8, 9)
"""Types of objects that have members: arrays and records (CiA 306)."""

_UNUSED = ("Comments", "DummyUsage", "DeviceComissioning")
_TEXTS = ("VendorName", "ProductName", "OrderCode")


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
        elif part.name not in _UNUSED:
            kept[part.name.lower()] = part
    kept.setdefault("deviceinfo", _Part("DeviceInfo", 0))
    sections = (f"[{one.name}]\n{_written(one)}" for one in kept.values())
    return "\n".join(sections), remarks


def _parts(text: str, remarks: list[str]) -> list[_Part]:
    """Return the sections of a text; a line that is no entry is left out."""
    parts: list[_Part] = []
    for number, line in enumerate(text.split("\n"), 1):
        head = _SECTION.match(line)
        key, sign, value = (one.strip() for one in line.partition("="))
        if head:
            parts.append(_Part(head[1].strip(), number))
        elif not line.strip() or line.lstrip()[0] in ";#":
            continue
        elif not (key and sign and parts):
            remarks.append(f"line {number}: {line.strip()[:60]!r} is no entry")
        elif parts[-1].name not in _UNUSED:
            parts[-1].entries.setdefault(key, value.partition(" ;")[0].strip())
    return parts


def _flaw_of(part: _Part, kept: dict[str, _Part]) -> str | None:
    """Return why a section cannot be used, None where it can; its numbers are mended."""
    entries, found = part.entries, _OBJECT.fullmatch(part.name)
    if part.name == "DeviceInfo":
        for key in [one for one in entries if one not in _TEXTS and not _is_number(entries, one)]:
            del entries[key]
    if found is None:
        return None
    wrong = _mend_numbers(entries)
    if wrong:
        return wrong
    if (found[2] or found[4]) and found[1].lower() not in kept:
        return f"belongs to the object {found[1]}, which is not there"
    if found[4]:
        return None if "NrOfEntries" in entries else "has no NrOfEntries"
    entries.setdefault("ParameterName", f"0x{found[1]}{'.' if found[3] else ''}{found[3] or ''}")
    grouped = int(entries.get("ObjectType", "7"), 0) in _GROUPS and "CompactSubObj" not in entries
    needed = () if grouped else ("DataType", "AccessType")
    return next((f"has no {key}" for key in needed if not entries.get(key)), None)


def _mend_numbers(entries: dict[str, str]) -> str | None:
    """Write the numbers of an object as Python does; return why its type is none."""
    for key in _NUMBERS:
        if entries.get(key) == "":
            del entries[key]
        elif key in entries and not _is_number(entries, key):
            if key in _TYPES:
                return f"has {key} = {entries[key]!r}"
            del entries[key]
    if all(key in entries and int(entries[key], 0) == 0 for key in ("LowLimit", "HighLimit")):
        del entries["LowLimit"], entries["HighLimit"]  # as many editors write no range
    return None


def _is_number(entries: dict[str, str], key: str) -> bool:
    """Return whether an entry is a number, which is then as Python writes it."""
    octal = _OCTAL.fullmatch(entries[key])
    entries[key] = f"0o{octal[1]}" if octal else entries[key].lstrip("+")
    for base in (0, 10):  # 08 is no octal number
        try:
            int(entries[key].replace("$NODEID", "").strip("+"), base)
        except ValueError:
            continue
        if base:
            entries[key] = str(int(entries[key]))
        return True
    return False


def _written(part: _Part) -> str:
    return "".join(f"{key}={value}\n" for key, value in part.entries.items())
