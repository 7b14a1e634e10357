"""Stop of a drive: what its reports mean for the state machine, and what holds it to the stop."""

import math
from collections.abc import Callable
from enum import Enum, auto

from adaptdrive.config.timing import Timing
from adaptdrive.control.signals import Stage
from adaptdrive.devices.port import Port, Reading
from adaptdrive.runtime.reports import State, StopWord
from adaptdrive.runtime.state_machine import Machine

# Holds a drive to its stop: it must confirm that its bridge is off, and keep it off.

_ON_READINGS = 2
"""Readings with the bridge on that are no flicker of a drive that has just stopped."""


class Stop(Enum):
    """State of the stop of a drive that is commanded off."""

    AWAITED = auto()
    CONFIRMED = auto()
    OVERDUE = auto()
    DENIED = auto()
    """The bridge came on, or was found on, without a command of this daemon."""


class StopWatch:
    """Compares the bridge that an idle drive reports with the safe command in force."""

    def __init__(self, timing: Timing, slack_s: float | None) -> None:
        """Expect a confirmation from the start on.

        Args:
            timing: Times of the drive.
            slack_s: Additional delay of the report of the bridge, None for a drive that never
                reports it.
        """
        self._confirmable = slack_s is not None
        self._coming_s = timing.coming_s
        self.limit_s = timing.switched_off_s + (slack_s or 0.0)
        self._commanded_s = math.inf
        self._confirmed = False
        self._coming = self._been_on = False
        self._come_s = -math.inf
        self._on: list[float] = []

    def release(self, reading: Reading | None = None, *, bridge: bool = False) -> None:
        """Note that the drive is energised: the next stop begins anew.

        Args:
            reading: The latest reading, None before the first.
            bridge: Whether the last command had the bridge on.
        """
        self._been_on = bridge and (self._been_on or (reading is not None and reading.bridge))
        self._coming = bridge and not self._been_on
        self._commanded_s, self._confirmed = math.inf, False

    def command(self, now_s: float) -> None:
        """Note that the drive is commanded off; the first time since its release counts."""
        if self._commanded_s == math.inf:
            self._commanded_s = now_s
            if self._coming:
                self._come_s = now_s + self._coming_s

    def judge(self, reading: Reading | None, safe_s: float, now_s: float) -> Stop:
        """Return what is known now.

        Args:
            reading: The latest reading, None before the first.
            safe_s: When bus or drive took the safe command, infinite while neither has.
            now_s: Monotonic time.
        """
        if not self._confirmable:
            self._confirmed = self._confirmed or safe_s < math.inf
        elif reading is not None and reading.bridge and self._confirmed:
            return self._denied(reading, now_s)
        elif reading is not None and not reading.bridge:
            self._on.clear()
            self._been_on = False
            due_s = max(safe_s, self._commanded_s, self._come_s)
            self._confirmed = self._confirmed or reading.bridge_reported_s > due_s
        if self._confirmed:
            return Stop.CONFIRMED
        return Stop.OVERDUE if now_s - self._commanded_s > self.limit_s else Stop.AWAITED

    def _denied(self, reading: Reading, now_s: float) -> Stop:
        """The bridge is on after a confirmed stop: denied by the second such reading.

        One that no other follows in the time of a stop is the drive's last word.
        """
        if reading.arrival_s not in self._on:
            self._on.append(reading.arrival_s)
        if len(self._on) < _ON_READINGS and now_s - reading.arrival_s <= self.limit_s:
            return Stop.CONFIRMED
        self.doubt(reading.arrival_s)
        return Stop.DENIED

    def doubt(self, now_s: float) -> None:
        """Wait for a confirmation again."""
        self._confirmed, self._commanded_s = False, now_s

    def why_not(self, reading: Reading | None, safe_s: float, now_s: float) -> str:
        """Return why the stop is not confirmed, and the likeliest remedy."""
        waited = f"{(now_s - self._commanded_s) * 1e3:.0f} ms after the stop"
        if safe_s == math.inf:
            return (
                f"it has not taken the safe command {waited}; check that it accepts commands from "
                "the bus (remote mode, write access), and disconnect its supply"
            )
        if reading is not None and reading.bridge and reading.bridge_reported_s > self._commanded_s:
            return (
                f"its bridge is still on {waited}; check that it accepts commands from the bus "
                "(remote mode, checksum, another sender), and disconnect its supply"
            )
        return (
            f"it has not reported its bridge off {waited}; check its cable and its supply, "
            "and disconnect the supply before the load is touched"
        )


# Stop of a drive: what its reports mean for the state machine.

_SWITCHED_ON = (
    "the drive's bridge is on although this daemon did not command it: look for another sender, a "
    "key on its panel, or a drive that restarts by itself"
)


class Stopping:
    """Holds the state machine to what the drive reports of its stop.

    Attributes:
        watch: Compares the reports of the drive with the stop.
        word: Confirmation of the stop by the drive.
    """

    def __init__(
        self, port: Port, timing: Timing, machine: Machine, report: Callable[[str], None]
    ) -> None:
        """Await a confirmation from the start on.

        Args:
            port: The drive.
            timing: Its times.
            machine: The state machine.
            report: Takes the problem when a tripped drive does not confirm its stop.
        """
        self._port = port
        self._machine = machine
        self.watch = StopWatch(timing, port.stop_slack_s)
        self._report = report
        self._settled_s = -math.inf
        self._starting = False
        self.word = StopWord.AWAITED

    def start(self) -> None:
        """Note that the boost voltage rises: a stop that ends it begins anew."""
        self._starting = True

    def release(self, reading: Reading | None = None, *, bridge: bool = False) -> None:
        """Note that the drive is energised: its word of the stop before says nothing any more.

        Args:
            reading: The latest reading, None before the first.
            bridge: Whether the last command had the bridge on.
        """
        self.watch.release(reading, bridge=bridge)
        self._starting = False
        self._settled_s = -math.inf
        self.word = StopWord.AWAITED

    def judge(self, reading: Reading | None, now_s: float) -> None:
        """Compare what the drive reports of its bridge with the stop that it was commanded.

        While only its boost voltage rises, its bridge is commanded off as it was before.
        """
        watch, machine = self.watch, self._machine
        if self._starting and machine.stage is not Stage.PRECHARGE:
            self.release()
        safe_s = -math.inf if self._starting else self._port.safe_s
        watch.command(now_s)
        verdict = watch.judge(reading, safe_s, now_s)
        settled = self._is_settled(verdict, now_s)
        if verdict is Stop.CONFIRMED:
            machine.confirm_stop()
            self.word = self._confirmation(reading, now_s) if settled else self.word
        elif verdict is Stop.DENIED:
            machine.doubt_stop()
            self._miss(_SWITCHED_ON)
        elif machine.state is State.STANDBY:
            self._await_first_word(reading, now_s)
        elif machine.state is State.STARTING and (reading is None or not reading.bridge):
            return  # as in `standby`, only a bridge that is on makes a missing word a problem
        elif verdict is Stop.OVERDUE and self.word is not StopWord.MISSING:
            self._miss(f"the drive does not stop: {watch.why_not(reading, safe_s, now_s)}")
        elif verdict is Stop.AWAITED and settled:
            self.word = StopWord.AWAITED

    def _confirmation(self, reading: Reading | None, now_s: float) -> StopWord:
        """Return the word on a stop that is complete.

        A drive that has been silent for a stop's time may have been switched on meanwhile: what it
        has confirmed is no word on it now.
        """
        if self._port.stop_slack_s is None:
            return StopWord.IMPOSSIBLE
        if reading is None or now_s - reading.bridge_reported_s > self.watch.limit_s:
            return StopWord.AWAITED
        return StopWord.CONFIRMED

    def _is_settled(self, verdict: Stop, now_s: float) -> bool:
        """Return whether a tripped drive that denied its stop has stayed off for a stop's time.

        Until then its stop is missing: a bridge that chatters makes one alarm, not one each time.
        """
        confirmed, settled = verdict is Stop.CONFIRMED, now_s >= self._settled_s
        if verdict is Stop.DENIED or not (confirmed or settled):
            self._settled_s = now_s + self.watch.limit_s
        return settled or self._machine.state is not State.TRIPPED

    def _await_first_word(self, reading: Reading | None, now_s: float) -> None:
        """Expect a drive to stop that is found on at the start."""
        if reading is not None and reading.bridge:
            self.watch.doubt(now_s)
            self._machine.doubt_stop()

    def _miss(self, problem: str) -> None:
        """Trip; a drive that had tripped before keeps that cause, and this one is reported once."""
        if self._machine.state is State.TRIPPED and self.word is not StopWord.MISSING:
            self._report(problem)
        self.word = StopWord.MISSING
        self._machine.latch(problem)
