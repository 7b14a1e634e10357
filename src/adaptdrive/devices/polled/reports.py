"""Reports of a drive that is polled: its readings, and whether commands may follow them."""

import math
from collections.abc import Callable, Sequence

from adaptdrive.config.polled import Heartbeat
from adaptdrive.control.signals import SAFE_COMMAND, Command
from adaptdrive.devices import binding, port
from adaptdrive.devices.description import Source
from adaptdrive.devices.polled.link import ExchangeError
from adaptdrive.devices.polled.mapping import HEARTBEAT, Named, Poll, explain, value_in
from adaptdrive.devices.polled.registers import Block
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.monitor import Doubt, Monitor, Verdict
from adaptdrive.safety.timing import Timing
from adaptdrive.safety.trips import Trip, TripKind

# Reports of a drive that is polled, and the judgement whether what energises may follow them.

_LOOK_TIMEOUTS = 0.5
"""Age of a report at which a write still follows, in time-outs besides those of the exchanges."""


class PollHistory:
    """Notes what the polls of a drive have shown, and what it has taken, each with its time.

    Times count from the request: the process may have stood still with the reply in its buffer.
    The safe command is always valid.

    Attributes:
        bridge: Bridge of the last command that the drive acknowledged.
        silent: Whether the drive did not answer the last poll.
        reported_s: When the last report of the bridge was asked for.
        fed_s: When the last command that the drive took was sent.
    """

    def __init__(
        self, drive: Monitor, timing: Timing, look_s: float, clock: Callable[[], float]
    ) -> None:
        """Begin without a report of the drive.

        Args:
            drive: The facts of the drive.
            timing: Times of the drive.
            look_s: Age of a report at which a write still follows it, in s.
            clock: Monotonic clock, in s.
        """
        self._monitor = drive
        self._timing = timing
        self._look_s = look_s
        self._clock = clock
        self._outdated = False
        self._seen_s = -math.inf
        self._stepped_s = math.inf
        self.bridge = self.silent = False
        self.reported_s = self.fed_s = -math.inf

    def renew(self, command: Command) -> None:
        """Note that a new command was decided."""
        self._monitor.command(command)
        self._outdated = False

    def take(self, command: Command, asked_s: float) -> None:
        """Note that the drive has acknowledged a command, which was sent at `asked_s`."""
        self.bridge, self.fed_s = command.bridge, asked_s
        self._monitor.take(command)

    def begin(self) -> None:
        """Begin a link: nothing is known of the drive on it."""
        self._monitor.lose()
        self.silent = self.bridge = False
        self.forget_report()
        self._stepped_s = self._clock()

    def note_step(self) -> None:
        """Note that the port does its work; a command from before a standstill is void."""
        now_s = self._clock()  # one look: the process may stand still between two
        self._outdated = self._outdated or self._stands_still(now_s)
        self._stepped_s = now_s

    def note_silence(self) -> None:
        """Note that nothing came; never after a reply, which would end the doubt of before."""
        if self.silent and self._may_have_timed_out:
            self._monitor.doubt(Doubt.UNANSWERED, self._clock())

    def note_bridge(self, *, powered: bool) -> None:
        """Note whether the drive reports its bridge on, or is assumed to have it on."""
        self._seen_s = self.reported_s
        self._monitor.report(on=powered, asked_s=self.reported_s, came_s=self._clock())

    def forget_report(self) -> None:
        """Begin a poll: reports of the one before do not count for its commands."""
        self._seen_s = -math.inf

    def admits(self, command: Command) -> bool:
        """Return whether a command is still valid.

        A process that did not run for long finds here what it decided before: that is void. So is
        one that energises a drive which may have stopped.
        """
        if command == SAFE_COMMAND:
            return True
        if self._outdated or self._stands_still(self._clock()):
            return False
        return not command.bridge or self._monitor.verdict is Verdict.OBEYS

    def may_go(self, command: Command, *, joined: bool) -> bool:
        """Return whether a valid command may be written: the poll has a report still good.

        Args:
            command: The command.
            joined: Whether it goes with the read that would show a stop, before its reply.
        """
        if not command.bridge or self._monitor.slack_s is None:
            return True
        age_s, timing = self._clock() - self._seen_s, self._timing
        if joined:  # now and then, commands would be far apart
            usual = age_s <= timing.usual_s and timing.silent_s >= timing.reading_s
            return usual and not self._may_have_timed_out
        return age_s < math.inf and (age_s <= self._look_s or not self._may_have_timed_out)

    @property
    def _may_have_timed_out(self) -> bool:
        """True if the drive has taken no command for as long as its own time-out may be."""
        return self._clock() - self.fed_s > self._timing.silent_s

    def _stands_still(self, now_s: float) -> bool:
        return now_s - self._stepped_s > self._timing.frozen_s


def look_limit_s(timeout_s: float, writes: int) -> float:
    """Return the age of a report at which a write still follows it, in s.

    It is that of a drive that answers the read, and each write before the last, just in time.

    Args:
        timeout_s: Longest time from a request to its reply, in s.
        writes: Writes that make one command.
    """
    return (writes + _LOOK_TIMEOUTS) * timeout_s


# Commands that a drive has not taken.

_REFUSED_WRITES = 2
"""Commands refused in a row after which the drive counts as refusing."""

_UNTAKEN_WRITES = 5
"""Commands in a row that a drive which answers reads has not taken, for whatever reasons.

Where one reply in twenty is lost, five in a row are within days, and three within minutes.
"""

_BUSY = frozenset({5, 6})
"""Exception codes of a drive that has no time for a command, and does not refuse it."""


class UntakenCommands:
    """Counts of commands that failed since the last one that the drive acknowledged.

    Attributes:
        doubtful: Whether the reply to the last one may still come: only silence shows that none is
            on its way.
    """

    def __init__(self) -> None:
        self._refused = self._untaken = 0
        self._kind = TripKind.COMMAND_REFUSED
        self.doubtful = False
        self.last = ""

    @property
    def trip_cause(self) -> Trip | None:
        """Reason not to energise the drive, None while too few commands have failed."""
        if self._refused < _REFUSED_WRITES and self._untaken < _UNTAKEN_WRITES:
            return None
        kind, does = TripKind.COMMAND_UNANSWERED, "does not answer"
        if self._refused:
            kind, does = self._kind, "refuses"
        check = "check [bus.registers], its remote mode and write access"
        return Trip(kind, f"the drive {does} commands: {self.last}; {check}")

    def note(self, failure: ExchangeError, *, silent: bool) -> None:
        """Note that the drive has not taken a command, or not provably.

        Args:
            failure: What came of it.
            silent: Whether the drive answers no reads either: it ignores more than commands.
        """
        self.doubtful = failure.doubtful
        refused = failure.code is not None and failure.code not in _BUSY
        self._refused = self._refused + 1 if refused else 0
        self._untaken += not silent
        self.last, self._kind = failure.problem, failure.kind

    def clear(self) -> None:
        """Note that the drive has acknowledged a command, or begin anew on another link."""
        self._refused = self._untaken = 0
        self.doubtful = False
        self.last = ""


# Putting the blocks of one poll together: a reading, or the reason why there is none.

STANDS_STILL = "the drive's heartbeat register stands still: its controller hangs"


class PollAssembly:
    """Collects the values of the blocks of a poll.

    Attributes:
        faults: Fault word of the drive.
        raw: Registers of each block that was read last.
    """

    def __init__(
        self, poll: Poll, heartbeat: Heartbeat, explain: Callable[..., str] = explain
    ) -> None:
        self._poll = poll
        self._heartbeat = heartbeat
        self._explain = explain
        self._newest = port.NewestValues(poll.sources)
        self._values: dict[str, float] = {}
        self._refused: dict[str, str] = {}
        self._known_beat: float | None = None
        self._advanced_s = -math.inf
        self.faults = self._newest.faults
        self.raw: dict[Block, list[int]] = {}

    @property
    def refusal(self) -> str:
        """Reason why values of the poll must not be used, empty where all may be."""
        if not self._refused:
            return ""
        first, *others = self._refused.values()
        return f"{first}, and {len(others)} more" if others else first

    def begin(self) -> None:
        """Begin a poll."""
        self._values.clear()
        self._refused.clear()

    def take(self, block: Block, sources: Sequence[Source[Named]], words: list[int]) -> None:
        """Take one block.

        Args:
            block: Which registers.
            sources: Quantities in them.
            words: Their contents.
        """
        self.raw[block] = words
        for source in sources:
            value = value_in(source, block, words)
            if value is not None:
                self._values[source.quantity] = value
            else:
                self._refused[source.quantity] = self._explain(source, block, words)
        self.faults.see(self._values)

    def bridge(self, sent: bool) -> bool | None:
        """Return the bridge of this poll, None where it must not be used.

        Args:
            sent: Bridge of the last command that the drive took: a drive that does not report its
                bridge is assumed to follow it.
        """
        reported = self._values.get(binding.BRIDGE)
        if reported is None:
            return None if self._poll.bridge_block else sent
        return reported != 0.0

    def reading(self, arrival_s: float, start_s: float, *, bridge_sent: bool) -> Reading | None:
        """Return the reading that a poll makes, None before every value has been good once.

        Args:
            arrival_s: When the last reply came, monotonic clock.
            start_s: When the poll began.
            bridge_sent: As for `bridge`.
        """
        values = {name: value for name, value in self._values.items() if name != HEARTBEAT}
        self._newest.keep(values, start_s, self._refused)
        return self._newest.reading(arrival_s, bridge=bridge_sent, set_s=start_s)

    def forget_heartbeat(self) -> None:
        """Forget the last heartbeat: the link was opened again."""
        self._known_beat, self._advanced_s = None, -math.inf

    def is_alive(self, now_s: float) -> bool | None:
        """Return whether the heartbeat of the drive advances, None while that is not known.

        Args:
            now_s: When the poll began, monotonic clock.
        """
        if self._heartbeat.drive is None:
            return True
        value = self._values.get(HEARTBEAT)
        known, self._known_beat = self._known_beat, value
        if known is None:
            return None  # one value alone shows no life, and neither does the same one again
        if value != known:
            self._advanced_s = now_s
            return True
        return now_s - self._advanced_s <= (self._heartbeat.drive_timeout_s or 0.0)
