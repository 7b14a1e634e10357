"""The stop of a drive: what its reports mean for the state machine."""

import math
from collections.abc import Callable
from typing import Final

from adaptdrive.control.signals import Stage
from adaptdrive.devices.port import Port
from adaptdrive.runtime.reports import State, StopWord
from adaptdrive.runtime.state_machine import Machine
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.stop import Stop, StopWatch
from adaptdrive.safety.timing import Timing
from adaptdrive.safety.trips import Trip, TripKind

_SWITCHED_ON: Final = Trip(
    TripKind.SWITCHED_ON,
    "the drive's bridge is on although this daemon did not command it: look for another sender, a "
    "key on its panel, or a drive that restarts by itself",
)


class Stopping:
    """Holds the state machine to what the drive reports of its stop.

    Attributes:
        watch: Compares the reports of the drive with the stop.
        status: Confirmation of the stop by the drive.
    """

    def __init__(
        self, port: Port, timing: Timing, machine: Machine, report: Callable[[Trip], None]
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
        self.watch = StopWatch(timing, port.monitor.slack_s)
        self._report = report
        self._settled_s = -math.inf
        self._starting = False
        self.status = StopWord.AWAITED

    def start(self) -> None:
        """Note that the boost voltage rises: a stop that ends it begins anew."""
        self._starting = True

    def release(self, reading: Reading | None = None, *, bridge: bool = False) -> None:
        """Note that the drive is energised: its report of the stop before counts no more.

        Args:
            reading: The latest reading, None before the first.
            bridge: Whether the last command had the bridge on.
        """
        self.watch.release(reading, bridge=bridge)
        self._starting = False
        self._settled_s = -math.inf
        self.status = StopWord.AWAITED

    def judge(self, reading: Reading | None, now_s: float) -> None:
        """Compare what the drive reports of its bridge with the stop that it was commanded.

        While only its boost voltage rises, its bridge is commanded off as it was before.
        """
        watch, machine = self.watch, self._machine
        if self._starting and machine.stage is not Stage.PRECHARGE:
            self.release()
        safe_s = -math.inf if self._starting else self._port.monitor.safe_s
        watch.command(now_s)
        verdict = watch.judge(reading, safe_s, now_s)
        settled = self._is_settled(verdict, now_s)
        if verdict is Stop.CONFIRMED:
            machine.confirm_stop()
            self.status = self._confirmation(reading, now_s) if settled else self.status
        elif verdict is Stop.DENIED:
            machine.withdraw_stop()
            self._trip(_SWITCHED_ON)
        elif machine.state is State.STANDBY:
            self._await_first_stop(reading, now_s)
        elif machine.state is State.STARTING and (reading is None or not reading.bridge):
            return  # as in `standby`, only a bridge that is on makes a missing report a problem
        elif verdict is Stop.OVERDUE and self.status is not StopWord.MISSING:
            self._trip(watch.unconfirmed(reading, safe_s, now_s))
        elif verdict is Stop.AWAITED and settled:
            self.status = StopWord.AWAITED

    def _confirmation(self, reading: Reading | None, now_s: float) -> StopWord:
        """Return the confirmation of a stop that is complete.

        A drive that has been silent for a stop's time may have been switched on meanwhile: what it
        has confirmed is no report of it now.
        """
        if self._port.monitor.slack_s is None:
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

    def _await_first_stop(self, reading: Reading | None, now_s: float) -> None:
        """Expect a drive to stop that is found on at the start."""
        if reading is not None and reading.bridge:
            self.watch.await_again(now_s)
            self._machine.withdraw_stop()

    def _trip(self, problem: Trip) -> None:
        """Trip; a drive that had tripped before keeps that cause, and this one is reported once."""
        if self._machine.state is State.TRIPPED and self.status is not StopWord.MISSING:
            self._report(problem)
        self.status = StopWord.MISSING
        self._machine.latch(problem)
