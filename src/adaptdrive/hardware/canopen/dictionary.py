"""The object dictionary: reading an EDS, and finding in it what a configuration names."""

from __future__ import annotations

import logging
import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

from canopen.objectdictionary import (
    INTEGER_TYPES,
    REAL32,
    REAL64,
    SIGNED_TYPES,
    ObjectDictionary,
    ODArray,
    ODRecord,
    ODVariable,
    import_od,
)

from adaptdrive.config.proposals import nearest
from adaptdrive.errors import ConfigurationError, Flaw
from adaptdrive.hardware.binding import Catalogue, Use
from adaptdrive.hardware.canopen.mending import mended
from adaptdrive.hardware.description import description_text, problem_text
from adaptdrive.hardware.field import Field, natural_limits, sensible_limits

Address = tuple[int, int]
Thing = ODVariable | ODRecord | ODArray

_EXPEDITED_BITS = 32
VENDOR = (0x1018, 1)
PRODUCT = (0x1018, 2)

logging.getLogger("canopen.objectdictionary").setLevel(logging.CRITICAL)  # `check` states it

_BY_NUMBER = re.compile(r"0[xX]([0-9A-Fa-f]{4})(?:\.(\d{1,3}))?")


@dataclass(frozen=True, slots=True)
class Entry:
    """One value of the drive.

    Attributes:
        index: Index of its object.
        subindex: Index within the object, 0 for an object that is one value.
        label: Its usual notation, such as `0x2001.2`.
        name: Its name in the EDS.
        bits: Length.
        signed: Whether it is a signed integer.
        real: Whether it is a floating-point number.
        low: Smallest raw value, None where the EDS sets no limit.
        high: Largest raw value, as above.
        readable: Whether the drive permits reading it.
        writable: Whether the drive takes it.
        mappable: Whether it may travel in a PDO.
    """

    index: int
    subindex: int
    label: str
    name: str
    bits: int
    signed: bool
    real: bool
    low: float | None
    high: float | None
    readable: bool
    writable: bool
    mappable: bool

    @property
    def address(self) -> Address:
        """Index and subindex."""
        return self.index, self.subindex

    def encode(self, value: float) -> bytes:
        """The bytes of a raw value.

        Raises:
            ValueError: It does not fit.
        """
        low, high = self.limits
        if not low <= value <= high or not (self.real or value == int(value)):
            kind = "number" if self.real else "integer"
            raise ValueError(f"{value!r} is no {kind} from {low:g} to {high:g}")
        if self.real:
            return struct.pack("<f" if self.bits == 32 else "<d", value)
        return int(value).to_bytes(self.bits // 8, "little", signed=self.signed)

    def decode(self, data: bytes) -> float:
        """The raw value of some bytes.

        Raises:
            ValueError: They are not as long as the entry.
        """
        if self.bits < 8 * len(data) <= _EXPEDITED_BITS:
            data = data[: self.bits // 8]  # a reply in one frame that does not state its length
        if 8 * len(data) != self.bits:
            raise ValueError(f"{len(data)} bytes are not the {self.bits} bits of {self.label}")
        if self.real:
            value: float = struct.unpack("<f" if self.bits == 32 else "<d", data)[0]
            return value
        return int.from_bytes(data, "little", signed=self.signed)

    @property
    def limits(self) -> tuple[float, float]:
        """Smallest and largest raw value: the EDS's limits within those of the type."""
        low, high = natural_limits(self.bits, signed=self.signed, real=self.real)
        if self.real:
            low, high = sensible_limits(low, high)
        return (
            low if self.low is None else max(low, self.low),
            high if self.high is None else min(high, self.high),
        )


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
    try:
        text, remarks = mended(description_text(path))
        named = StringIO(text)
        named.name = str(path)  # from which the parser takes the format
        return _sound(import_od(named, node_id)), remarks
    except Exception as problem:  # the parser's own errors are of many kinds
        flaw = Flaw("bus.eds", f"{path} cannot be used: {problem_text(problem)}")
        raise ConfigurationError(source, [flaw]) from problem


def _sound(dictionary: ObjectDictionary) -> ObjectDictionary:
    if not len(dictionary):
        raise ValueError("it describes no object")
    return dictionary


def load_dictionary(
    path: Path, node_id: int, source: Path | str = "configuration"
) -> ObjectDictionary:
    """Read an EDS file, as `read_eds` does, for its objects alone."""
    return read_eds(path, node_id, source)[0]


class ObjectCatalogue(Catalogue[Entry]):
    """Finds entries by name or number, and collects an error for each missing entry."""

    def __init__(self, dictionary: ObjectDictionary, remarks: Sequence[str] = ()) -> None:
        super().__init__()
        self._dictionary = dictionary
        self._remarks = remarks
        self.warn_of_file("bus.eds", remarks)

    def field(self, item: Entry, use: Use) -> Field:  # noqa: ARG002 - limits hold for all uses
        """Return how an entry is coded."""
        low, high = item.limits
        return Field(item.name, low, high, integer=not item.real)

    def refusal(self, item: Entry, use: Use) -> str | None:
        """Return why an entry cannot travel in a PDO of this direction, None where it can."""
        if use in {"command", "constant"}:
            fits, verb = item.writable, "take"
        else:
            fits, verb = item.readable, "send"
        if fits and item.mappable:
            return None
        return f"the drive does not {verb} {item.name!r} in a PDO"

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
            hint = f"{self._hint(reference)}{self.remark(reference)}"
            self.note(place, f"the EDS has no object {reference!r}{hint}")
            return None
        if not isinstance(thing, ODVariable):
            self.note(place, f"object {reference!r} has members: name one of them")
            return None
        entry = _entry(thing)
        if entry is None:
            self.note(place, f"object {reference!r} is no number of at most 64 bits")
        return entry

    def remark(self, reference: str) -> str:
        """Return what is wrong in the file with an object of that number, empty for nothing."""
        number = _BY_NUMBER.fullmatch(reference)
        sub = f"sub{int(number[2]):x}" if number and number[2] else ""
        named = f"[{number[1]}{sub}]".lower() if number else "[]"
        found = next((one for one in self._remarks if named in one.lower()), "")
        return found and f"; {found}"

    def _look_up(self, reference: str) -> Thing | None:
        number = _BY_NUMBER.fullmatch(reference)
        if number is None:
            return self._named(reference)
        index = int(number[1], 16)
        if number[2] is None:
            return self._dictionary.get(index)
        return self._dictionary.get_variable(index, int(number[2]))

    def _named(self, name: str) -> Thing | None:
        found: Thing | None = self._dictionary.names.get(name)
        if found is None and "." in name:
            outer, _, inner = name.partition(".")
            found = getattr(self._dictionary.names.get(outer), "names", {}).get(inner)
        return found

    def _hint(self, reference: str) -> str:
        known = [
            variable.qualname
            for thing in self._dictionary.values()
            for variable in ([thing] if isinstance(thing, ODVariable) else thing.values())
        ]
        return nearest(reference, known)


def _entry(variable: ODVariable) -> Entry | None:
    real = variable.data_type in {REAL32, REAL64}
    if not real and variable.data_type not in INTEGER_TYPES:
        return None
    return Entry(
        index=variable.index,
        subindex=variable.subindex,
        label=label((variable.index, variable.subindex)),
        name=variable.qualname,
        bits=len(variable),
        signed=variable.data_type in SIGNED_TYPES,
        real=real,
        low=variable.min,
        high=variable.max,
        readable=variable.readable,
        writable=variable.writable,
        mappable=variable.pdo_mappable,
    )
