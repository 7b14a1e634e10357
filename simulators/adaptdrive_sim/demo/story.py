"""Stories as data, one file each, and what a demonstration of one learns from its messages."""

import math
import tomllib
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from adaptdrive.analysis.curves import judge_step
from adaptdrive.control.signals import Waveform
from adaptdrive.mqtt.commands import number
from adaptdrive.tui.record import Mark, Payload, WatchRecord
from adaptdrive.util.errors import RefusedError
from adaptdrive_sim.parameters import example_tables

# Stories as data: one file each, which names what happens when, and the sentence about it.

FOLDER = Path(__file__).parent / "stories"


class Scene(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One turn of a story.

    Attributes:
        at_s: When it comes, since the story began.
        say: What to look at.
        mode: Controller to ask for; the one of before when left out.
        setpoint: A constant set-point; as above.
        waveform: A waveform instead of it.
        disturb: Request to the simulated device; `disks` is how many are to be on the shaft.
    """

    at_s: float
    say: str
    mode: str | None = None
    setpoint: float | None = None
    waveform: Waveform | None = None
    disturb: dict[str, float] | None = None


class Overshoot(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Sizes of the load by which the overshoots are shown.

    Attributes:
        of: The size in the truth of the simulator.
        sizes: Its values.
        names: A name for each.
        adaptive_at_most: Largest share of a step by which the adaptive controller may overshoot.
    """

    of: str
    sizes: list[float]
    names: list[str]
    adaptive_at_most: float = 1.0

    def index(self, size: object) -> int | None:
        """Return which of the sizes the load has, None for none of them."""
        if not isinstance(size, int | float):
            return None
        near = (k for k, one in enumerate(self.sizes) if abs(size - one) < 0.005 * one)
        return next(near, None)


class Value(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A value of the truth that is shown.

    Attributes:
        name: Its name for the viewer.
        of: Its name in the truth of the simulator.
        keep: The last value, the highest one, or the energy in J of a power while it was negative.
        unit: Unit, after the scale.
        scale: Factor.
        at_most: Largest value for which control has worked.
        at_least: Smallest one.
        from_s: Time of the story from which on these count.
    """

    name: str
    of: str
    keep: Literal["last", "highest", "returned"] = "last"
    unit: str = ""
    scale: float = 1.0
    at_most: float = math.inf
    at_least: float = -math.inf
    from_s: float = 0.0

    def fits(self, value: float) -> bool:
        """Return whether control has worked, as far as this value shows it."""
        return self.at_least <= value <= self.at_most


class Story(
    msgspec.Struct,
    frozen=True,
    forbid_unknown_fields=True,
    rename={"scenes": "scene", "values": "value"},
):
    """A load, and what happens to it.

    Attributes:
        about: What is seen, in one line.
        configuration: The example configuration that daemon and simulated drive read.
        noise: Standard deviation of each sample of the output.
        duration_s: How long it takes.
        window_s: Longest time that the plot shows.
        scenes: The first one begins it.
        speed: Times real time.
        initial_voltage_V: Boost voltage at which the load rests at the begin, None for standstill.
        changes: Values that replace those of the configuration.
        drop: Disturbances that the key `d` sends, in turn.
        overshoot: Sizes for the table of overshoots.
        values: Values for the table in its place.
        complete: What to say when the load has what it needs.
        name: Name of the file.
    """

    about: str
    configuration: str
    noise: float
    duration_s: float
    window_s: float
    scenes: list[Scene]
    speed: float = 1.0
    initial_voltage_V: float | None = None
    changes: dict[str, dict[str, Any]] = {}
    drop: list[dict[str, float]] = []
    overshoot: Overshoot | None = None
    values: list[Value] = []
    complete: str = ""
    name: str = ""

    def conditions(self, number: int) -> tuple[Scene, list[dict[str, float]]]:
        """Return what the scenes up to one have asked for, and how the load is then disturbed."""
        held, disturbances = self.scenes[number], dict[str, dict[str, float]]()
        for scene in self.scenes[: number + 1]:
            if scene.disturb is not None:
                disturbances[next(iter(scene.disturb))] = scene.disturb
        for scene in reversed(self.scenes[:number]):
            held = msgspec.structs.replace(held, mode=held.mode or scene.mode)
            if held.setpoint is None and held.waveform is None:
                wave, constant = scene.waveform, scene.setpoint
                held = msgspec.structs.replace(held, waveform=wave, setpoint=constant)
        return held, list(disturbances.values())

    def document(self) -> dict[str, Any]:
        """Return the configuration of the daemon, with the changes of this story."""
        found = example_tables(self.configuration)
        _change(found, self.changes)
        return found


def _change(tables: dict[str, Any], changes: dict[str, Any]) -> None:
    for name, value in changes.items():
        if isinstance(value, dict):
            _change(tables.setdefault(name, {}), value)
        else:
            tables[name] = value


def story_names() -> list[str]:
    """Return the names of all stories."""
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def read_story(name: str) -> Story:
    """Read a story.

    Raises:
        RefusedError: There is none of that name.
    """
    if name not in story_names():
        raise RefusedError(f"{name!r} is no story; there are {', '.join(story_names())}")
    document = tomllib.loads((FOLDER / f"{name}.toml").read_text(encoding="utf-8"))
    return msgspec.convert(document | {"name": name}, Story)


# What a demonstration learns from its messages: overshoots, values, trips.

_SETTLED_PERIODS = 12
"""Slow periods that a half wave must last before its overshoot counts."""

Case = tuple[str, int | None]
"""Controller and size of the load at the step that begins a half wave."""


class Halves:
    """Collects slow samples and finds the overshoot of each half wave.

    It is that of the controller in force at the step, also where another one has ended it.
    """

    def __init__(self) -> None:
        self._case: Case | None = None
        self._before = math.nan
        self._outputs: list[float] = []
        self._reference: float | None = None
        self._found: dict[Case, float] = {}

    def add(self, reference: float, output: float, controller: str, size: int | None) -> None:
        """Take in one slow period.

        Args:
            reference: Set-point.
            output: In the same unit.
            controller: The controller in force.
            size: Which size the load has, None for one in between.
        """
        if self._case is not None and size != self._case[1]:
            self._close()
        if self._reference is not None and reference != self._reference:
            self._close()
            self._case, self._before, self._outputs = (controller, size), self._reference, []
        self._reference = reference
        if self._case is not None:
            self._outputs.append(output)

    def begin(self, reference: float) -> None:
        """Begin anew, near a reference: something else than a step has moved the output."""
        self._case, self._reference = None, reference

    def overshoot(self, controller: str, size: int) -> float | None:
        """The overshoot of the last half wave of a case, None before the first."""
        return self._found.get((controller, size))

    def _close(self) -> None:
        """End a half wave, at its end or when something is changed; a long one counts."""
        case, self._case = self._case, None
        if case is None or self._reference is None or len(self._outputs) < _SETTLED_PERIODS:
            return
        beyond, _ = judge_step(np.array(self._outputs), self._before, self._reference)
        self._found[case] = beyond


TRIPPED = "trip"
_COUNTED = ("ticks", "missed", "held")
_MARKS = 200


@dataclass(slots=True)
class DemoRecord(WatchRecord):
    """Received messages, and what follows from them for the end of the demonstration.

    Attributes:
        story: What is played.
        trips: Every trip.
        completed: Whether the load has what it needs.
        control_s: Time of the drive's clock that was spent running.
        counts: Ticks, missed and held ones, while the drive ran.
        slow_periods: Slow periods so far.
        halves: Overshoots.
        size: Which of the story's sizes the load had last.
        values: The story's values.
    """

    story: Story = field(kw_only=True)
    trips: list[str] = field(default_factory=list)
    completed: bool = False
    control_s: float = 0.0
    counts: dict[str, float] = field(default_factory=lambda: dict.fromkeys(_COUNTED, 0.0))
    slow_periods: int = 0
    halves: Halves = field(default_factory=Halves)
    size: int | None = None
    values: dict[str, float] = field(default_factory=dict)
    marks: deque[Mark] = field(default_factory=lambda: deque(maxlen=_MARKS))
    _truth_tick: float = 0.0

    @property
    def running(self) -> bool:
        """True if the drive is under control."""
        return self.state.get("state") == "running"

    @property
    def trip(self) -> str:
        """The trip that is latched, empty for none."""
        return str(self.state.get("trip") or "")

    def take(self, name: str, content: Payload) -> None:
        """Take a message.

        Args:
            name: Topic below that of the drive.
            content: Its payload.
        """
        fast = self.fast
        first_s = self.points[-1].time_s if self.points else math.inf
        WatchRecord.take(self, name, content)
        match name:
            case "telemetry/drive" if self.running and self.points:
                self.control_s += max(0.0, self.points[-1].time_s - first_s)
                for one in _COUNTED:
                    self.counts[one] += content.get(one, 0) - fast.get(one, 0)
            case "telemetry/load":
                self._take_load(content)
            case "event":
                self._take_event(content)
            case "simulator" if content:
                self._take_truth(content)

    def _take_load(self, content: Payload) -> None:
        self.slow_periods += 1
        values = number(content.get("reference")), number(content.get("output"))
        if all(map(math.isfinite, values)):
            self.halves.add(*values, str(content.get("controller")), self.size)

    def _take_event(self, content: Payload) -> None:
        if content.get("kind") == "trip":
            self.trips.append(str(content.get("detail")))
            self.mark(TRIPPED)
        self.completed = self.completed or content.get("kind") == "complete"

    def _take_truth(self, content: Payload) -> None:
        """Keep the story's values, and mark a load that has got another size."""
        known = self.story.overshoot
        size = known.index(content.get(known.of)) if known else None
        if known and size is not None and size != self.size and self.size is not None:
            self.mark(known.names[size])
        self.size = self.size if size is None else size
        half_cycles = number(content.get("tick")) - self._truth_tick
        self._truth_tick += half_cycles
        since_s = half_cycles * number(content.get("half_cycle_s"))
        for one in self.story.values:
            new, old = one.scale * number(content.get(one.of)), self.values.get(one.name, 0.0)
            if one.keep == "returned":
                new = old + max(0.0, -new) * since_s
            self.values[one.name] = max(old, new) if one.keep == "highest" else new

    def mark(self, text: str) -> None:
        """Mark in the plot what was done."""
        self.marks.append((self.now_s, text))
