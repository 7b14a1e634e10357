"""Binds the quantities of a configuration to the values of a device, on every kind of bus.

A bus supplies a `Catalogue`: it finds what a configuration names in the description of its device,
and gives the `Field` of it. Units, enumerations, words, ranges against trips, demands on the
commands and constants are checked here, for drives and sensors.
"""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from threading import Event
from typing import Generic, Literal

from adaptdrive.config import bus, root, section
from adaptdrive.devices import description
from adaptdrive.devices.description import Item, Sink, Source, is_word
from adaptdrive.devices.field import Field
from adaptdrive.safety.facts import FaultWord
from adaptdrive.util.errors import Flaw, nearest

Use = Literal["measured", "word", "state", "command", "constant", "setup"]
"""Role of a value that is received or sent; a state is the report of the bridge."""

BRIDGE, RESET = "bridge", "reset"
_COMMAND = "signals.command"

_MOST_REMARKS = 5
_FEW_COUNTS = 20.0
"""Counts within the limits of a command below which its scale is probably missing."""

_ROUNDING = 1e-6
"""Share of one count by which a value may miss its count in binary."""

_PRECISION = 1e-12
"""Share of itself by which a value of more than 40 bits may do so."""

Given = tuple[str, bus.SignalSource, str]
"""A quantity, its entry in the configuration, and the place of that."""


def sensor_entries(sensors: root.SensorBusSection, place: str) -> Iterator[Given]:
    """Yield every quantity that sensors send."""
    return ((name, given, f"{place}.signals.{name}") for name, given in sensors.signals.items())


class Catalogue(ABC, Generic[Item]):
    """Finds values by name in the description of a device, and collects what is wrong.

    Attributes:
        flaws: What keeps the configuration from being used.
        cautions: What can be used, and is probably not meant.
        on: Value that means on where the configuration states none, None for any but 0.
    """

    on: float | None = 1.0
    has_copies = False
    """True where a measured value may be sent back with the command."""

    def __init__(self, remarks: Sequence[str] = ()) -> None:
        """Find nothing yet.

        Args:
            remarks: What is wrong in the file of the device, each with its line.
        """
        self.flaws: list[Flaw] = []
        self.cautions: list[Flaw] = []
        self._remarks = remarks

    @abstractmethod
    def find(self, reference: str, place: str) -> Item | None:
        """Return what a reference names, or None and a flaw at `place`."""

    @abstractmethod
    def field(self, item: Item, use: Use) -> Field:
        """Return how a value is coded."""

    def refusal(self, item: Item, use: Use) -> str | None:  # noqa: ARG002 - most take all
        """Return why the device does not give or take a value in this way, None where it does."""
        return None

    def count_problem(self, item: Item) -> str | None:
        """Return why a value cannot be a counter, None where it can."""
        field = self.field(item, "word")
        return None if field.low == 0 else f"{field.name!r} is no unsigned integer"

    def switch(self, item: Item) -> tuple[float, float]:  # noqa: ARG002 - most have none
        """Return the values that switch on and off where the configuration states none."""
        return 1.0, 0.0

    def note(self, place: str, problem: str | None) -> None:
        """Collect a flaw, where there is one."""
        if problem:
            self.flaws.append(Flaw(place, problem))

    def remark(self, name: str) -> str:
        """Return what is wrong in the file where it has a name, empty for nothing."""
        named = re.compile(rf"(?<!\w){re.escape(name)}(?!\w)", re.IGNORECASE)
        found = next(filter(named.search, self._remarks), "")
        return found and f"; {found}"

    def warn_of_file(self, place: str) -> None:
        """Collect what is wrong in the file of a device, as far as nothing uses it."""
        self.cautions += [Flaw(place, remark) for remark in self._remarks[:_MOST_REMARKS]]
        if len(self._remarks) > _MOST_REMARKS:
            more = len(self._remarks) - _MOST_REMARKS
            self.cautions.append(Flaw(place, f"{more} more lines have such flaws"))

    def sources(
        self, given: Iterable[Given], demands: description.Demands = description.NO_DEMANDS
    ) -> list[Source[Item]]:
        """Find the source of each quantity; what does not fit is collected.

        Args:
            given: Quantities and their entries.
            demands: What the signals must be able to carry.
        """
        found = []
        for quantity, entry, place in given:
            item = self.find(entry.signal, place)
            if item is not None:
                found.append(self._source((quantity, entry, place), item, demands))
        return found

    def sinks(
        self, command: bus.CommandSignals, demands: description.Demands = description.NO_DEMANDS
    ) -> list[Sink[Item]]:
        """Find the destination of each part of the command; what does not fit is collected.

        Args:
            command: `[signals.command]`.
            demands: What the signals must be able to carry.
        """
        found = self.settings(command.constants, f"{_COMMAND}.constants")
        if command.copies and not self.has_copies:
            self.note(f"{_COMMAND}.copies", "are for a drive that is described by a DBC")
        for name in ("current_scale_S", "boost_reference_V"):
            entry: bus.SignalSource | None = getattr(command, name)
            item = None if entry is None else self.find(entry.signal, f"{_COMMAND}.{name}")
            if entry is not None and item is not None:
                found.append(self._value(name, entry, item, demands))
        resets = (replace(one, reset=Event()) for one in self._switches(command.reset, RESET))
        return [*found, *self._switches(command.bridge), *resets]

    def settings(
        self, given: Mapping[str, float | str], place: str, use: Use = "constant"
    ) -> list[Sink[Item]]:
        """Find the destinations of values that stay the same; what does not fit is collected."""
        found = []
        for reference, constant in given.items():
            at = f"{place}.{reference}"
            item = self.find(reference, at)
            if item is None:
                continue
            self.note(at, self.refusal(item, use))
            field = self.field(item, use)
            value = self.resolve(field, constant, at)
            if value is not None and self._is_sent(field, value, at):
                found.append(Sink(reference, item, field, value, 0.0))
        return found

    def resolve(self, field: Field, given: float | str, place: str) -> float | None:
        """Return a value, or the one that a name of the field's value table stands for.

        It is None, and a flaw at `place`, where there is no such name.
        """
        if not isinstance(given, str):
            return float(given)
        found = sorted(raw for raw, name in field.names.items() if name == given)
        if len(found) == 1:
            return field.physical(found[0])
        problem, values = f"has no {given!r}", ", ".join(map(str, found))
        if found:
            problem = f"gives several values the name {given!r}: {values}"
        hint = "" if found else nearest(given, list(field.names.values()))
        self.note(place, f"the value table of {field.name!r} {problem}{hint}")
        return None

    def _source(self, given: Given, item: Item, demands: description.Demands) -> Source[Item]:
        quantity, entry, place = given
        use: Use = "word" if is_word(quantity) else "measured"
        field, on, word = self.field(item, "state" if quantity == BRIDGE else use), None, None
        self.note(place, self.refusal(item, use))
        if is_word(quantity):
            self._check_word(given, item, field)
        else:
            self.check_unit(entry, field, demands.unit_of(quantity), place)
            self._check_trip(given, field, demands)
        if isinstance(entry, bus.FaultSource):
            word = self._watched(quantity, entry, field, place)
        elif quantity.endswith(bus.CODE):
            label, of = self._label(entry), quantity.removesuffix(bus.CODE)
            word = FaultWord(label, -1, field.names, code_of=of)
        if isinstance(entry, bus.SwitchSource):
            on = self._on(entry, field, f"{place}.on")
        return Source(quantity, item, field, entry.scale, entry.offset, on, place, word)

    def check_unit(self, entry: bus.SignalSource, field: Field, wanted: str, place: str) -> None:
        """Collect what is wrong with the unit of an entry, which should lead to the wanted one."""
        problem = section.unit_problem(entry, field.unit, wanted)
        self.note(place, problem and f"{entry.signal}: {problem}")
        caution = section.unit_caution(entry, field.unit) if wanted else None
        if caution and not problem:
            self.cautions.append(Flaw(place, f"{entry.signal}: {caution}"))

    def _check_trip(self, given: Given, field: Field, demands: description.Demands) -> None:
        """Refuse a value without room above what trips: it could never be seen there."""
        quantity, entry, place = given
        key, limit = demands.trips.get(quantity, ("", -math.inf))
        highest = max(end * entry.scale + entry.offset for end in field.ends)
        if highest <= limit:
            problem = f"{field.name} has values up to {highest:g} only"
            self.note(place, f"{problem}: interlocks.{key} = {limit:g} can never trip")

    def _check_word(self, given: Given, item: Item, field: Field) -> None:
        """Refuse a word that is no count as it stands."""
        quantity, entry, place = given
        if (entry.scale, entry.offset) != (1.0, 0.0):
            self.note(place, "is an integer: it takes no scale and no offset")
        problem = self.count_problem(item) if quantity == "counter" else None
        if not field.is_word:
            problem = problem or f"{field.name!r} must be an integer with factor 1 and offset 0"
        self.note(place, problem)

    def _watched(
        self, quantity: str, entry: bus.FaultSource, field: Field, place: str
    ) -> FaultWord:
        """Return a watched word.

        Refuse a healthy value without a name, a state 0 that would have to be a fault, and bits
        that the signal does not have.
        """
        values = [self.resolve(field, one, f"{place}.healthy") for one in entry.healthy]
        if entry.healthy and 0 in field.names and 0 not in values:
            problem = f"leaves out 0 ({field.names[0]}), which is never a fault"
            self.note(f"{place}.healthy", problem)
        highest = int(field.high).bit_length() - (field.low >= 0)
        for key, bits in (("mask", entry.mask or 0), ("names", max(entry.named, default=0))):
            if bits.bit_length() - 1 > highest:
                problem = f"{field.name!r} has no bit {bits.bit_length() - 1}"
                self.note(f"{place}.{key}", f"{problem}: its highest is {highest}")
        return FaultWord(
            self._label(entry),
            entry.bits,
            {**field.names, **entry.named},
            frozenset(int(value) for value in values if value is not None),
            warns=quantity.startswith("warning"),
        )

    @staticmethod
    def _label(entry: bus.SignalSource) -> str:
        """Return the name of a word for a trip: of a signal its own, of an object all of it."""
        numbered = entry.signal[:2].lower() == "0x"
        return entry.signal if numbered else entry.signal.rpartition(".")[2]

    def _on(self, entry: bus.SwitchSource, field: Field, place: str) -> float | None:
        """Return the value that means on; one that no good report has is a flaw."""
        given = self.on if entry.on is None else entry.on
        on = None if given is None else self.resolve(field, given, place)
        if field.is_word and on is not None:
            problem = field.problem(on)
            self.note(place, problem and f"the bridge would never be on: {problem}")
        others = [
            f"{raw} ({name})"
            for raw, name in sorted(field.names.items())
            if raw not in {0, 1} and field.value(raw) is not None
        ]
        if entry.on is None and given is not None and others:
            word = f"1 ({field.names[1]})" if 1 in field.names else "1"
            off = f"{', '.join(others)} that the bridge is off, which confirms a stop"
            problem = f"is left out: {word} alone means on, and {off}; name the state of on"
            self.cautions.append(Flaw(place, problem))
        return on

    def _switches(
        self, switch: bus.CommandSwitch | None, name: str = BRIDGE
    ) -> Iterator[Sink[Item]]:
        place = f"{_COMMAND}.{name}"
        item = None if switch is None else self.find(switch.signal, place)
        if switch is None or item is None:
            return
        self.note(f"{place}.off_signal", "is for coils" if switch.off_signal else None)
        self.note(place, self.refusal(item, "command"))
        field, known = self.field(item, "command"), self.switch(item)
        on = self.resolve(field, known[0] if switch.on is None else switch.on, place)
        off = self.resolve(field, known[1] if switch.off is None else switch.off, place)
        if on is None or off is None:
            return
        self.note(place, f"on and off are both {on:g}" if on == off else None)
        if self._is_sent(field, off, place) and self._is_sent(field, on, place):
            yield Sink(name, item, field, off, on - off)

    def _value(
        self, name: str, entry: bus.SignalSource, item: Item, demands: description.Demands
    ) -> Sink[Item]:
        """Return where a value goes; one that cannot be 0, or what the limits allow, is a flaw."""
        place, field = f"{_COMMAND}.{name}", self.field(item, "command")
        sink = Sink(name, item, field, -entry.offset / entry.scale, 1.0 / entry.scale)
        self.note(place, self.refusal(item, "command"))
        self.check_unit(entry, field, demands.unit_of(name), place)
        sent = self._sent(field, sink.base, place)
        if sent is None:
            return sink
        if sent != sink.base:
            zero = (sent - sink.base) / sink.factor
            self.note(place, f"0 would be sent as {zero:.4g}: it could not be safe")
        ends = [float(getattr(one, name)) for one in demands.commands]
        for wanted in ends:
            problem = field.problem(sink.base + sink.factor * wanted)
            limit = f"cannot carry {wanted:g}, a limit of [drive.limits]"
            self.note(place, problem and f"{limit}: {problem}")
        counts = abs(sink.factor / field.scale) * (max(ends, default=0.0) - min(ends, default=0.0))
        if field.integer and 0.0 < counts < _FEW_COUNTS:
            coarse = f"[drive.limits] spans {counts:.3g} counts of it: is its scale right?"
            self.cautions.append(Flaw(place, f"{entry.signal}: {coarse}"))
        return sink

    def _is_sent(self, field: Field, value: float, place: str) -> bool:
        """Return whether a value can be sent; one that is not sent as it stands is a flaw."""
        sent = self._sent(field, value, place)
        if sent is not None and sent != value:
            problem = f"{field.name} = {value:.10g} would be sent as {sent:.10g}"
            self.note(place, f"{problem}: its counts are {abs(field.scale):g} apart")
        return sent is not None

    def _sent(self, field: Field, value: float, place: str) -> float | None:
        """Return what is sent for a value, None and a flaw where the field cannot be it."""
        problem = field.problem(value)
        self.note(place, problem and f"the drive could not be switched: {problem}")
        if problem:
            return None
        sent, rounding = field.physical(field.raw(value)), _ROUNDING * abs(field.scale)
        return value if math.isclose(sent, value, rel_tol=_PRECISION, abs_tol=rounding) else sent
