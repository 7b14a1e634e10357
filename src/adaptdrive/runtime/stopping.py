"""Stop of a drive: what its reports mean for the state machine."""

from __future__ import annotations

import math
from collections.abc import Callable

from adaptdrive.config.timing import Timing
from adaptdrive.control.signals import Stage
from adaptdrive.devices.port import Port, Reading
from adaptdrive.runtime.machine import Machine
from adaptdrive.runtime.reports import State, StopWord
from adaptdrive.runtime.stop_watch import Stop, StopWatch

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
