"""Reports of the runtime: immutable snapshots, and the queues that take them to everyone else.

Each subscriber has its own bounded queue. A full queue drops its oldest report and counts the
drop, so that a stalled broker or disk costs history and never a tick.
"""

import asyncio
import math
from collections import deque
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Any, Generic, TypeVar

from adaptdrive.control import signals
from adaptdrive.control.signals import UNKNOWN, Reach
from adaptdrive.runtime.requests import ProgramReport
from adaptdrive.runtime.timebase import NO_TIMES, Quantiles
from adaptdrive.safety.trips import TripKind
from adaptdrive.util.errors import escaped
from adaptdrive.util.quantity import Quantity, columns_of
from adaptdrive.util.trends import HealthReport

# Reports of the runtime: immutable snapshots, never live objects.

MONOTONIC = "monotonic_s"
"""Column with the monotonic time of a row."""


class State(StrEnum):
    """State of the drive's state machine."""

    STANDBY = "standby"
    STARTING = "starting"
    RUNNING = "running"
    STOPPING = "stopping"
    TRIPPED = "tripped"


class StopWord(StrEnum):
    """Confirmation of a stop by the drive."""

    CONFIRMED = "confirmed"
    AWAITED = "awaited"
    MISSING = "missing"
    IMPOSSIBLE = "cannot be confirmed"


class Severity(StrEnum):
    """Severity of an event."""

    INFO = "info"
    WARNING = "warning"
    ALARM = "alarm"


@dataclass(frozen=True, slots=True)
class StateReport:
    """The operator's view of the drive; published whenever it changes.

    Attributes:
        state: State of the state machine.
        mode: What the operator asked for.
        controller: What is in force.
        reason: Why `controller` differs from `mode`, or an empty string.
        enabled: Whether the drive has been enabled.
        setpoint: Constant set-point in the unit of the output; the last one while a waveform runs.
        slope: Change of the reference in one second on its way there; None once it is there.
        waveform: The running waveform, None while the set-point is constant.
        pole: Closed-loop pole asked for.
        trip: Text of the latched trip, None when not tripped.
        shutting_down: Whether the daemon ends and refuses every command but `disable`.
        stop: Confirmation of the stop by the drive, None while it may be energised.
        voltage_V: V_c that the operator has set in mode manual, None in every other.
        reach: What V_c can hold: lowest and highest output at rest, NaN while not known.
        coasting: Whether the enabled drive is held off until a set-point within reach.
        trip_kind: Kind of the latched trip, None when not tripped.
        program: The program that runs, or has run last; None before the first.
    """

    state: State
    mode: signals.Mode
    controller: signals.Mode
    reason: str
    enabled: bool
    setpoint: float
    waveform: signals.Waveform | None
    pole: float
    trip: str | None
    shutting_down: bool = False
    stop: StopWord | None = None
    voltage_V: float | None = None
    reach: Reach = UNKNOWN
    coasting: bool = False
    trip_kind: TripKind | None = None
    slope: float | None = None
    program: ProgramReport | None = None


@dataclass(frozen=True, slots=True)
class LoadReport:
    """One slow period: what was sampled, and what was made of it.

    Attributes:
        snapshot: What was sampled.
        decision: What was made of it.
        time_s: Monotonic time at which the decision was taken over.
    """

    snapshot: signals.Snapshot
    decision: signals.Decision
    time_s: Annotated[
        float,
        Quantity("s", "monotonic time at which the decision was taken over", MONOTONIC),
    ] = math.nan


@dataclass(frozen=True, slots=True)
class SensorReport:
    """One sensor bus.

    Attributes:
        name: Name of the bus.
        up: Whether it answers.
        detail: Its latest report, empty while all has been well.
        values: Latest values by name, in SI.
        age_s: Age of each.
        bus: Counts of its port, by name.
    """

    name: str
    up: bool
    detail: str
    values: dict[str, float]
    age_s: dict[str, float]
    bus: dict[str, int]


@dataclass(frozen=True, slots=True)
class SensorSample:
    """Values of the sensor buses at a fast tick that had a new one.

    Attributes:
        time_s: Monotonic time of the sample.
        values: Latest values in SI; the key is `BUS.VALUE`.
        age_s: Age of each.
    """

    time_s: float
    values: dict[str, float]
    age_s: dict[str, float]


@dataclass(frozen=True, slots=True)
class DriveReport:
    """The fast loop, at most ten times a second.

    Attributes:
        measurement: Last measurement, None before the first.
        age_s: Age of that measurement.
        command: Last command sent.
        ticks: Fast ticks so far.
        missed: Half cycles that passed without a tick of their own.
        held: Stand-in ticks that no frame replaced.
        lateness_us: Lateness of the ticks since the last report.
        turnaround_us: Status frame in to command frame out, since the last report.
        bus: Frame counts of the port, by name.
        tick_us: Duration of the ticks themselves, since the last report.
        sensors: Separate sensor buses.
        limited: Commands that were held to a limit of `[drive.limits]` since the start.
        histograms: Counts of all lateness, turn-around and tick times since the start, by bin.
        time_s: Monotonic time of the report.
        remaining_s: Least time to the end of the program that runs, None without one.
    """

    measurement: signals.Measurement | None
    age_s: float
    command: signals.Command
    ticks: int
    missed: int
    held: int
    lateness_us: Quantiles
    turnaround_us: Quantiles
    bus: dict[str, int]
    tick_us: Quantiles = NO_TIMES
    sensors: tuple[SensorReport, ...] = ()
    limited: int = 0
    histograms: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    time_s: float = math.nan
    remaining_s: float | None = None


EVENT_KINDS = (
    *("trip", "state", "controller", "mode", "fallback", "program", "complete", "stop", "refused"),
    *("bus", "warning", "latency", "realtime", "checkpoint", "recording", "state directory"),
    *("broker", "command", "outbox", "configuration", "health"),
)
"""Kinds of events: of the drive, of the daemon's machine, and of the operators' side."""


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened once: a trip, a mode change, a bus loss.

    Attributes:
        kind: Short machine-readable name, such as `trip`, `mode`, `fallback`, `bus`.
        severity: How much it matters.
        detail: One sentence; what is not UTF-8, as the name of a file may be, is escaped.
        tick: Fast tick at which it happened.
        trip_kind: Kind of the trip, None where it is none.
    """

    kind: str
    severity: Severity
    detail: str
    tick: int
    trip_kind: TripKind | None = None

    def __post_init__(self) -> None:
        """Escape what neither a record nor a message can take."""
        object.__setattr__(self, "detail", escaped(self.detail))


@dataclass(frozen=True, slots=True)
class TickReport:
    """One fast tick, whole: enough to run the controller again.

    A jump of the tick is a missed half cycle; a jump of the sequence is a lost report.
    """

    sequence: Annotated[
        int,
        Quantity("", "running number of the ticks since the controller was built, from 0"),
    ]
    measurement: signals.Measurement
    order: signals.Order
    applied_k: Annotated[
        int,
        Quantity("", "slow index of the decision that took effect at this tick, -1 for none"),
    ]
    command: signals.Command
    lateness_us: Annotated[float, Quantity("µs", "lateness of the tick")]
    turnaround_us: Annotated[
        float,
        Quantity("µs", "status frame in to command frame out; NaN on a stand-in tick"),
    ]
    tick_us: Annotated[float, Quantity("µs", "duration of the tick, from interlocks to wire")] = (
        math.nan
    )
    time_s: Annotated[float, Quantity("s", "monotonic time at the end of the tick", MONOTONIC)] = (
        math.nan
    )


@dataclass(frozen=True, slots=True)
class CommandReport:
    """An operator's command that was answered.

    Attributes:
        id: Id that its sender gave it.
        verb: What was asked for.
        value: The value asked for, as JSON, and its unit where it was sent.
        user: Name that its sender gives itself; empty without one.
        accepted: Whether it was carried out.
        reason: Why not.
    """

    id: str
    verb: str
    value: str
    user: str
    accepted: bool
    reason: str


Note = Event | CommandReport
Report = StateReport | LoadReport | DriveReport | SensorSample | Note | TickReport | HealthReport

TICK_COLUMNS = columns_of(TickReport)
SLOW_COLUMNS = columns_of(LoadReport)


# Reports from the runtime to everyone else, through queues that can never block it.

T = TypeVar("T")


class Queue(Generic[T]):
    """A bounded queue between two tasks; the oldest item goes when it is full.

    Attributes:
        dropped: Items that went because the queue was full.
        limit: Most items that wait.
    """

    def __init__(self, limit: int) -> None:
        self.dropped = 0
        self.limit = limit
        self._items: deque[T] = deque()
        self._filled = asyncio.Event()

    def __len__(self) -> int:
        return len(self._items)

    def put(self, item: T) -> None:
        """Leave an item; returns at once."""
        self._items.append(item)
        self._filled.set()
        if len(self._items) > self.limit:
            self._items.popleft()
            self.dropped += 1

    def drain(self) -> Sequence[T]:
        """Take all there are, maybe none, without waiting."""
        self._filled.clear()
        taken = tuple(self._items)
        self._items.clear()
        return taken

    async def take(self) -> Sequence[T]:
        """Wait until there is at least one item, then take all there are."""
        await self._filled.wait()
        return self.drain()

    async def oldest(self) -> T:
        """Wait for an item; it stays in the queue."""
        await self._filled.wait()
        return self._items[0]

    async def take_oldest(self) -> T:
        """Wait for the oldest item and take it."""
        item = await self.oldest()
        self._remove_oldest()
        return item

    def _remove_oldest(self) -> None:
        self._items.popleft()
        if not self._items:
            self._filled.clear()


Subscription = Queue[Any]
"""One subscriber's queue, with reports of the kinds that it asks for."""

Keep = Callable[[], Awaitable[None]]
"""Waits until all that was published is in a file, for a short bounded time at most."""


async def wait_for_nothing(_patience_s: float = 0.0) -> None:
    """Return at once, where nothing is kept."""


class Hub:
    """Hands each report to every subscriber of its kind.

    Attributes:
        kept: Waits until all that was published so far is recorded; at once where nothing is.
            Subscribers call it before an event leaves the process, so that no kill can leave an
            event with an operator and not in the session. A disk that hangs delays it by a bounded
            time.
    """

    def __init__(self) -> None:
        self._queues: dict[type[Report], list[Subscription]] = {}
        self.kept: Keep = wait_for_nothing

    def subscribe(self, *kinds: type[Report], size: int) -> Subscription:
        """Open a queue for the given kinds of report.

        Args:
            kinds: Report classes.
            size: Reports held before the oldest is dropped.
        """
        subscription = Subscription(size)
        for kind in kinds:
            self._queues.setdefault(kind, []).append(subscription)
        return subscription

    def publish(self, report: Report) -> None:
        """Offer a report to its subscribers. Never blocks, never fails."""
        for subscription in self._queues.get(type(report), ()):
            subscription.put(report)
