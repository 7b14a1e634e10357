"""The object dictionary: reading an EDS, and finding in it what a configuration names."""

from __future__ import annotations

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

from adaptdrive.config.proposals import nearest
from adaptdrive.errors import ConfigurationError, Flaw
from adaptdrive.hardware.binding import Catalogue, Use
from adaptdrive.hardware.canopen.mending import mended
from adaptdrive.hardware.description import read_description
from adaptdrive.hardware.field import Field, natural_limits, sensible_limits

Address = tuple[int, int]
Thing = ODVariable | ODRecord | ODArray

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

    return read_description(path, source, "bus.eds", parse)


class ObjectCatalogue(Catalogue[Entry]):
    """Finds entries by name or number, and collects an error for each missing entry."""

    def __init__(self, dictionary: ObjectDictionary, remarks: Sequence[str] = ()) -> None:
        super().__init__(remarks)
        self._dictionary = dictionary
        self.warn_of_file("bus.eds")

    def field(self, item: Entry, use: Use) -> Field:  # noqa: ARG002 - limits hold for all uses
        """Return how an entry is coded."""
        return item.coding

    def refusal(self, item: Entry, use: Use) -> str | None:
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
