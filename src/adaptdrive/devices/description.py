"""Files that describe a drive: reading them, what they must carry, and a proposal of signals.

A proposal is a start for a configuration; its author confirms each line.
"""

import codecs
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from pathlib import Path
from textwrap import shorten
from threading import Event
from typing import Generic, TypeVar

from adaptdrive.config import Configuration, bus, section
from adaptdrive.control.signals import Command
from adaptdrive.devices.field import Field
from adaptdrive.safety.facts import FaultWord
from adaptdrive.util.errors import ConfigurationError, Flaw
from adaptdrive.util.quantity import MEASURED

# Files that describe a drive: read whole, and never waited for.

Parsed = TypeVar("Parsed")

_LONGEST_PROBLEM = 300
"""A parser quotes the line at fault, and a file that is no text may be one line."""


def description_text(path: Path) -> str:
    """Return the text of a DBC or EDS file, in whichever encoding its editor wrote it.

    A byte order mark decides; without one it is UTF-8, or else Windows code page 1252.

    Args:
        path: The file.

    Raises:
        OSError: It cannot be read, or is no regular file.
        ValueError: No file can have such a name, or the bytes contradict the byte order mark.
    """
    if not path.is_file():  # a pipe or a terminal would be waited for
        raise OSError("there is no such file" if not path.exists() else "it is no regular file")
    content = path.read_bytes()
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return content.decode("utf-16")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", "replace")


def read_description(
    path: Path, source: Path | str, place: str, parse: Callable[[str], Parsed]
) -> Parsed:
    """Return what a parser makes of a file.

    Args:
        path: The file.
        source: The configuration that names it, for the error message.
        place: Where the configuration names it.
        parse: The parser.

    Raises:
        ConfigurationError: The file cannot be read or parsed.
    """
    try:
        return parse(description_text(path))
    except Exception as error:  # parsers raise errors of many kinds
        text = shorten(str(error) or type(error).__name__, _LONGEST_PROBLEM, placeholder="…")
        raise ConfigurationError(source, [Flaw(place, f"{path} cannot be used: {text}")]) from error


# Values that the description of a drive must be able to carry.


@dataclass(frozen=True, slots=True)
class Demands:
    """Requirements of the limits of a configuration on its signals.

    Attributes:
        output_unit: Unit of the regulated quantity, empty where it has none.
        drive_unit: Unit of what the drive is commanded, and gives.
        commands: Commands at the ends of their limits; each must be sent as it is.
        trips: Key of the value above which each quantity trips, and the value; the signal must
            be able to show more.
    """

    output_unit: str = ""
    drive_unit: str = "V"
    commands: tuple[Command, ...] = ()
    trips: Mapping[str, tuple[str, float]] = field(default_factory=dict)

    def unit_of(self, quantity: str) -> str:
        """The unit of a quantity, empty for one of any unit."""
        if quantity in {"boost_voltage_V", "boost_reference_V"}:
            return self.drive_unit
        return self.output_unit if quantity == "output" else section.WANTED.get(quantity, "")


NO_DEMANDS = Demands()


def demands_of(configuration: Configuration) -> Demands:
    """Return what the limits of a configuration ask of its signals."""
    limits, trips = configuration.drive.limits, configuration.interlocks
    in_daemon = configuration.voltage_loop.where == "daemon"
    lowest_S = configuration.drive.current_scale_min_S if in_daemon else 0.0
    scale_S = limits.current_scale_max_S if in_daemon else 0.0
    return Demands(
        output_unit=configuration.load.output_unit,
        drive_unit=configuration.drive.manipulated.unit,
        commands=(
            Command(lowest_S, limits.boost_reference_min_V, bridge=True),
            Command(scale_S, limits.boost_reference_max_V, bridge=True),
        ),
        trips={
            "boost_voltage_V": ("boost_voltage_max_V", trips.boost_voltage_max_V),
            "output": ("output_max", trips.output_max),
        },
    )


# Where a quantity comes from, and where a part of the command goes to.

Item = TypeVar("Item")


def is_word(quantity: str) -> bool:
    """Return whether a quantity is an integer as it stands."""
    return quantity.partition(".")[0] in bus.WORDS


@dataclass(frozen=True, slots=True)
class Source(Generic[Item]):
    """Source of a quantity.

    Attributes:
        quantity: Field of `Reading`, or one of its other values.
        item: What the description of the device has for it.
        field: How that is coded.
        scale: SI units per unit of the field.
        offset: SI value where the field is zero.
        on: Value of a switch that means on, None where any but 0 does.
        place: Its place in the configuration.
        word: What is a fault or a warning in it, None for another quantity.
        slack_s: How much older than `interlocks.stale_s` its values may be, as their message or
            the clock, with which they are taken, comes less often.
        cycle_by: What sets the cycle of the slower of them: GenMsgCycleTime or a key of `[bus]`.
        cycle_s: Time from one such value to the next, infinite where it is not stated how often
            its message comes.
    """

    quantity: str
    item: Item
    field: Field
    scale: float
    offset: float
    on: float | None
    place: str
    word: FaultWord | None = None
    slack_s: float = 0.0
    cycle_by: str = ""
    cycle_s: float = 0.0

    @property
    def is_other(self) -> bool:
        """True for a value that is no quantity and no word."""
        return not (self.quantity in MEASURED or is_word(self.quantity))


@dataclass(frozen=True, slots=True)
class Sink(Generic[Item]):
    """Destination of a part of the command: base + factor × that field of `Command`.

    Attributes:
        name: Field of `Command`; the reference of a constant, whose factor is 0.
        item: What the description of the device has for it.
        field: How that is coded.
        base: Value of the field of the device where that of the command is 0 or False.
        factor: Units of the field per unit of that of the command.
        only: Bridge of the commands that it is written with, None for all.
        reset: Set while the reset of a fault is given, which takes the place of that field.
    """

    name: str
    item: Item
    field: Field
    base: float
    factor: float
    only: bool | None = None
    reset: Event | None = None

    @property
    def is_commanded(self) -> bool:
        """True for a part of the command that is no constant, and no copy of what is measured."""
        return self.reset is not None or self.name in bus.COMMANDED

    def value(self, command: Command) -> float:
        """The value in the unit of the field."""
        if not self.factor:
            return self.base
        if self.reset is not None:  # only of a drive that is off
            return self.base + self.factor * (self.reset.is_set() and not command.bridge)
        return self.base + self.factor * float(getattr(command, self.name))


# Proposal of the signal of each quantity, by unit and by name.

_UNIT_POINTS = 3  # a unit counts more than one word of a name
_NAME_POINTS = 2  # a word that names the quantity counts more than one that goes with it
_LEAST_BITS = 8  # shorter values are flags and states, no quantities

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

    Blanks separate words and units. The own name of a signal decides, without that of its message
    or record: what stands in `Status` is no state for that.

    Attributes:
        words: Parts of a name that mean the quantity; one of them is needed.
        against: Parts of a name that mean something else.
        units: Units of which it must have one; none for a value without a unit.
        kind: Parts of a name of which a value without a unit needs one in place of it.
        beside: Parts of a name, or of that of its message, that often go with it.
        named: Parts of a name that mean it where a named value of it means on.
        commanded: True for a value that the daemon sends.
    """

    words: str
    against: str = ""
    units: str = ""
    kind: str = ""
    beside: str = ""
    named: str = ""
    commanded: bool = False


@cache
def wanted_by(load: str) -> Mapping[str, Wanted]:
    """Return what the signals look like that a drive with a load has, by quantity.

    Args:
        load: Type of the load; the output of one that nothing describes fits no candidate.
    """
    text = (resources.files("adaptdrive.devices") / "proposal.toml").read_text(encoding="utf-8")
    tables = tomllib.loads(text)
    looks = {"output": tables["output"].get(load, {"words": ""}), **tables["quantity"]}
    return {name: Wanted(**look) for name, look in looks.items()}


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
    """Return whether the likeliest candidate and the next one score the same."""
    best = [_points(wanted, one) for one in proposed[:2]]
    return len(best) == 2 and best[0] == best[1]


def _points(wanted: Wanted, candidate: Candidate) -> int:
    """Return the score of a candidate; 0 for one that it cannot be."""
    own, all_parts = _parts(candidate.words.rpartition(".")[2]), _parts(candidate.words)
    named = _spoken(wanted.words, own) + (candidate.on is not None and _spoken(wanted.named, own))
    if not named or candidate.commanded is not wanted.commanded or _spoken(wanted.against, own):
        return 0
    unit, units = candidate.unit, wanted.units.split()
    right = unit in units if unit else not units or _spoken(wanted.kind, own)
    if not right or (units and candidate.bits < _LEAST_BITS):
        return 0
    points = _NAME_POINTS * named + _spoken(wanted.beside, all_parts)
    return points + _UNIT_POINTS if unit else points


def _parts(words: str) -> set[str]:
    """Return the lower-case words of names such as `BoostVoltage`, `U_DC` and `N_ACT`."""
    return {part.lower() for part in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", words)}


def _spoken(words: str, parts: set[str]) -> int:
    """Return how many of some words are parts of a name."""
    return sum(_speaks(word, parts) for word in words.split())


def _speaks(word: str, parts: set[str]) -> bool:
    return word in parts or (len(word) > 3 and any(part.startswith(word) for part in parts))


def _first_named(names: tuple[str, ...], wanted: tuple[str, ...]) -> str | None:
    return next((name for word in wanted for name in names if name.lower() == word), None)
