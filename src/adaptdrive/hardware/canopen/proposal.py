"""Objects of an EDS, as candidates for the quantities of a configuration."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from canopen.objectdictionary import ODVariable

from adaptdrive.hardware.canopen.dictionary import ObjectCatalogue, load_dictionary
from adaptdrive.hardware.proposal import Candidate

_FIRST_DEVICE_OBJECT = 0x2000
"""Objects below are communication parameters (CiA 301)."""

_STATE_WORDS = (0x6040, 0x6041)
"""Controlword and statusword, which the profile itself uses (CiA 402)."""


def candidates(path: Path, node_id: int) -> Iterator[Candidate]:
    """Yield every object that may be a quantity.

    Args:
        path: EDS file.
        node_id: Node id of the drive.

    Raises:
        ConfigurationError: The file cannot be read or is no EDS.
    """
    dictionary = load_dictionary(path, node_id, path)
    catalogue = ObjectCatalogue(dictionary)
    for thing in dictionary.values():
        for variable in [thing] if isinstance(thing, ODVariable) else thing.values():
            entry = catalogue.at((variable.index, variable.subindex))
            device = variable.index >= _FIRST_DEVICE_OBJECT and variable.index not in _STATE_WORDS
            if entry is not None and device and entry.mappable:
                yield Candidate(
                    reference=entry.label,
                    words=entry.name,
                    unit="",
                    range="",
                    commanded=entry.writable,
                    bits=entry.bits,
                )
