"""Proposal of the signal of each quantity, by unit and by name.

A proposal is a start for a configuration; its author confirms each line.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

_VOLT = "V mV kV"
_WATT = "W kW"

_NAME_POINTS = 2  # one word that names a quantity outweighs one that contradicts it
_UNIT_POINTS = 3  # a unit counts more than one word of a name
_LEAST_BITS = 8  # shorter values are flags and states, no quantities

_OF_THE_BUS = "node id baud address version lockout discharge"
_OPPOSITES = f"{_OF_THE_BUS} disable disabled inhibit off not"

_ON = ("run", "on", "enabled", "enable", "operation", "active", "start")
_OFF = ("stop", "off", "disabled", "disable", "standby", "idle", "ready")


@dataclass(frozen=True, slots=True)
class Candidate:
    """One value that a DBC or EDS describes.

    Attributes:
        reference: Name in a configuration, such as `Status.BoostVoltage` or `0x6079`.
        words: Names and comments that describe it.
        unit: Unit as in the configuration, an empty string for none.
        range: Range as text, such as `0…600`.
        commanded: True for a value that the daemon sends.
        names: Names of its values, as a value table has them.
        bits: Length.
    """

    reference: str
    words: str
    unit: str
    range: str
    commanded: bool
    names: tuple[str, ...] = ()
    bits: int = 16

    @property
    def on(self) -> str | None:
        """Name of the value that probably means on."""
        return _first_named(self.names, _ON)

    @property
    def off(self) -> str | None:
        """Name of the value that probably means off."""
        return _first_named(self.names, _OFF)


@dataclass(frozen=True, slots=True)
class Wanted:
    """Units and names by which a quantity is recognised in foreign descriptions.

    Blanks separate words and units.

    Attributes:
        words: Parts of a name that count for it.
        against: Parts of a name that count against it.
        units: Units of which it must have one; none for a value without a unit.
        never: Parts of a name that no such value has.
        commanded: True for a value that the daemon sends.
    """

    words: str
    against: str = ""
    units: str = ""
    never: str = ""
    commanded: bool = False


QUANTITIES: Mapping[str, Wanted] = {
    "boost_voltage_V": Wanted("boost bst dc link zwk cap bus", "set ref line mains", _VOLT),
    "line_voltage_V": Wanted("line mains grid netz ac supply", "dc boost link", _VOLT),
    "load_power_W": Wanted("power load out p", "limit max", _WATT),
    "counter": Wanted("half cycle count tick", "alive crc hours"),
    "fault": Wanted("fault error alarm trip", "crc alive"),
    "bridge": Wanted("bridge run state status enabled on", "fault alive crc", "", _OPPOSITES),
    "command.current_scale_S": Wanted("current scale k conductance", units="S", commanded=True),
    "command.boost_reference_V": Wanted(
        "boost dc link voltage set ref", "line mains", _VOLT, _OF_THE_BUS, commanded=True
    ),
    "command.bridge": Wanted(
        "bridge enable run request start", "alive crc page mode", "", _OPPOSITES, commanded=True
    ),
}

NO_PROPOSAL = Wanted("")
"""Fits no candidate: the output of a load that `OUTPUTS` does not describe is left to its user."""

OUTPUTS: Mapping[str, Wanted] = {
    "motor": Wanted("speed tach rpm n act omega", units="rpm rad/s V Hz"),
    "bath": Wanted("temp bath water t", "heatsink igbt", "K degC degF"),
    "battery": Wanted("current batt out i", "line limit", "A mA kA"),
}


def propose(wanted: Wanted, candidates: Iterable[Candidate]) -> tuple[Candidate, ...]:
    """Return the candidates for a quantity, the likeliest first.

    Args:
        wanted: What the quantity looks like.
        candidates: Everything that is described.
    """
    ranked = [(_points(wanted, one), one) for one in candidates]
    fitting = [pair for pair in ranked if pair[0] > 0]
    fitting.sort(key=lambda pair: -pair[0])  # stable: equals stay in the order of the file
    return tuple(one for _, one in fitting)


def is_doubtful(wanted: Wanted, proposed: tuple[Candidate, ...]) -> bool:
    """Return whether nothing tells the likeliest candidate from the next one."""
    best = [_points(wanted, one) for one in proposed[:2]]
    return len(best) == 2 and best[0] == best[1]


def _points(wanted: Wanted, candidate: Candidate) -> int:
    """Return the score of a candidate; 0 for one that it cannot be."""
    if candidate.commanded is not wanted.commanded:
        return 0
    if candidate.unit and candidate.unit not in wanted.units.split():
        return 0
    parts = _parts(candidate.words)
    short = bool(wanted.units) and candidate.bits < _LEAST_BITS
    if short or any(word in parts for word in wanted.never.split()):
        return 0
    named = sum(1 for word in wanted.words.split() if _speaks(word, parts))
    against = sum(1 for word in wanted.against.split() if _speaks(word, parts))
    fits = _UNIT_POINTS if candidate.unit else 0
    return max(0, fits + _NAME_POINTS * named - against) if named else 0


def _parts(words: str) -> set[str]:
    """Return the lower-case words of names such as `BoostVoltage`, `U_DC` and `N_ACT`."""
    return {part.lower() for part in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", words)}


def _speaks(word: str, parts: set[str]) -> bool:
    short = len(word) <= 3
    return word in parts if short else any(part.startswith(word) for part in parts)


def _first_named(names: tuple[str, ...], wanted: tuple[str, ...]) -> str | None:
    return next((name for word in wanted for name in names if name.lower() == word), None)
