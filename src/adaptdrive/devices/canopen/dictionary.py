"""The object dictionary: reading an EDS, and finding in it what a configuration names.

An object that cannot be mended is left out, so that it is an error only for who names it.
"""

import contextlib
import logging
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path

from canopen.objectdictionary import ObjectDictionary, ODArray, ODRecord, ODVariable
from canopen.objectdictionary.datatypes import FLOAT_TYPES, NUMBER_TYPES, SIGNED_TYPES
from canopen.objectdictionary.eds import import_eds

from adaptdrive.devices import binding, description
from adaptdrive.devices.field import Field, natural_limits, sensible_limits
from adaptdrive.util.errors import ConfigurationError, Flaw, nearest

# Lines of an EDS that its parser refuses, although nothing may use them.

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
"""Names of entries as the parser spells them."""


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
    """Return the name of a section as the parser spells it, from any case."""
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


# The object dictionary: reading an EDS, and finding in it what a configuration names.

Address = tuple[int, int]
Thing = ODVariable | ODRecord | ODArray

DEVICE_TYPE = (0x1000, 0)
SYNC_ID = (0x1005, 0)
SYNC_PERIOD = (0x1006, 0)
HEARTBEATS_HEARD = (0x1016, 1)
HEARTBEAT_SENT = (0x1017, 0)
ABORT_OPTION = (0x6007, 0)
QUICK_STOP_OPTION = (0x605A, 0)
VENDOR = (0x1018, 1)
PRODUCT = (0x1018, 2)
_ERROR_CODE = 0x603F

logging.getLogger("canopen.objectdictionary").setLevel(logging.CRITICAL)  # `check` states it

_BY_NUMBER = re.compile(r"0[xX]([0-9A-Fa-f]{4})(?:\.(\d{1,3}))?")


@dataclass(frozen=True, slots=True)
class Entry:
    """One value of the drive.

    Attributes:
        address: Index of its object, and index within that, 0 for an object that is one value.
        bits: Length.
        variable: What the EDS says of it.
        coding: How it is coded, within the limits of the EDS and of its type.
    """

    address: Address
    bits: int
    variable: ODVariable = field(compare=False)
    coding: Field = field(compare=False)

    @property
    def label(self) -> str:
        """Its usual notation, such as `0x2001.2`."""
        return label(self.address)

    @property
    def size(self) -> int:
        """Its bytes."""
        return (self.bits + 7) // 8

    def decode(self, data: bytes) -> float:
        """The raw value of some bytes.

        Raises:
            ValueError: They are not as long as the entry.
        """
        if len(data) != self.size:
            raise ValueError(f"{len(data)} bytes are not the {self.bits} bits of {self.label}")
        return float(self.variable.decode_raw(data))


def label(address: Address) -> str:
    """Return an address in the usual notation, such as `0x2001.2`."""
    index, subindex = address
    return f"0x{index:04X}.{subindex}" if subindex else f"0x{index:04X}"


def read_eds(
    path: Path, node_id: int, source: Path | str = "configuration"
) -> tuple[ObjectDictionary, list[str]]:
    """Read an EDS file: its objects, and what is wrong in it with the lines.

    Args:
        path: The file.
        node_id: The drive's node id, on which some of its defaults depend.
        source: The configuration that names it, for the error message.

    Raises:
        ConfigurationError: The file cannot be read or is no EDS.
    """
    if path.suffix.lower() not in {".eds", ".dcf"}:
        raise ConfigurationError(source, [Flaw("bus.eds", f"{path} is no .eds and no .dcf file")])

    def parse(text: str) -> tuple[ObjectDictionary, list[str]]:
        text, remarks = mended(text)
        dictionary = import_eds(StringIO(text), node_id)
        if not dictionary:
            raise ValueError("it describes no object")
        return dictionary, remarks

    return description.read_description(path, source, "bus.eds", parse)


class ObjectCatalogue(binding.Catalogue[Entry]):
    """Finds entries by name or number, and collects an error for each missing entry."""

    def __init__(self, dictionary: ObjectDictionary, remarks: Sequence[str] = ()) -> None:
        super().__init__(remarks)
        self._dictionary = dictionary
        self.warn_of_file("bus.eds")

    def field(self, item: Entry, use: binding.Use) -> Field:  # noqa: ARG002 - limits hold for all uses
        """Return how an entry is coded."""
        return item.coding

    def refusal(self, item: Entry, use: binding.Use) -> str | None:
        """Return why an entry cannot travel in a PDO of this direction, None where it can."""
        name, variable = item.coding.name, item.variable
        if use == "setup":
            return None if variable.writable else f"{name!r} cannot be written"
        sent = use not in {"command", "constant"}
        if variable.pdo_mappable and (variable.readable if sent else variable.writable):
            return None
        emergency = item.address[0] == _ERROR_CODE
        also = ": leave it out, its emergencies report errors" if sent and emergency else ""
        return f"the drive does not {'send' if sent else 'take'} {name!r} in a PDO{also}"

    @property
    def identity(self) -> tuple[tuple[Address, int], ...]:
        """Vendor and product as the EDS gives them, with the entries where the drive does."""
        device = self._dictionary.device_information
        given = (VENDOR, device.vendor_number), (PRODUCT, device.product_number)
        return tuple((address, number) for address, number in given if number and self.at(address))

    def has(self, index: int) -> bool:
        """Return whether the drive has an object."""
        return index in self._dictionary

    def at(self, address: Address) -> Entry | None:
        """The entry at an address, None when the EDS has none."""
        variable = self._dictionary.get_variable(*address)
        return None if variable is None else _entry(variable)

    def find(self, reference: str, place: str) -> Entry | None:
        """The number that a reference names, or None and a flaw at `place`.

        Args:
            reference: `0x6079`, `0x2001.2`, `Name` or `Record.Member`.
            place: Where the reference stands.
        """
        thing = self._look_up(reference)
        if thing is None:
            known = [variable.qualname for variable in self.variables()]
            hint = f"{nearest(reference, known)}{self.remark(reference)}"
            self.note(place, f"the EDS has no object {reference!r}{hint}")
            return None
        if not isinstance(thing, ODVariable):
            self.note(place, f"object {reference!r} has members: name one of them")
            return None
        entry = _entry(thing)
        if entry is None:
            self.note(place, f"object {reference!r} is no number of at most 64 bits")
        return entry

    def remark(self, name: str) -> str:
        """Return what is wrong in the file with an object of that number, empty for nothing."""
        number = _BY_NUMBER.fullmatch(name)
        sub = f"sub{int(number[2]):x}" if number and number[2] else ""
        return super().remark(f"[{number[1]}{sub}]") if number else ""

    def variables(self) -> Iterator[ODVariable]:
        """Yield every value, members of objects too."""
        for thing in self._dictionary.values():
            yield from [thing] if isinstance(thing, ODVariable) else thing.values()

    def _look_up(self, reference: str) -> Thing | None:
        number = _BY_NUMBER.fullmatch(reference)
        if number and number[2]:
            return self._dictionary.get_variable(int(number[1], 16), int(number[2]))
        with contextlib.suppress(KeyError, TypeError):  # a value has no members
            return self._dictionary[int(number[1], 16) if number else reference]
        return None


def _entry(variable: ODVariable) -> Entry | None:
    if variable.data_type not in NUMBER_TYPES:
        return None
    bits, real = len(variable), variable.data_type in FLOAT_TYPES
    low, high = natural_limits(bits, signed=variable.data_type in SIGNED_TYPES, real=real)
    if real:
        low, high = sensible_limits(low, high)
    if (variable.min, variable.max) != (0, 0):  # as many editors write no range
        low = low if variable.min is None else max(low, variable.min)
        high = high if variable.max is None else min(high, variable.max)
    coded = Field(variable.qualname, low, high, integer=not real)
    return Entry((variable.index, variable.subindex), bits, variable, coded)
