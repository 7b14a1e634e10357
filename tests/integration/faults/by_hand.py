"""The whole daemon but its broker, run by hand: no event loop, no bus, and a clock that is set.

Whoever steps it delivers readings, lets the timer expire and has the slow loop decide, in whatever
order the real event loop might choose.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections import deque
from collections.abc import Callable
from typing import Any

from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings, fast_settings, machine_limits
from adaptdrive.config.root import Configuration
from adaptdrive.control.controller import Controller
from adaptdrive.control.signals import Command, Decision
from adaptdrive.runtime.daemon import Daemon
from adaptdrive.runtime.fast_loop import FastLoop
from adaptdrive.runtime.reports import Event, Hub, LoadReport, State
from adaptdrive.runtime.requests import Request
from adaptdrive.runtime.tick_support import ServiceManager
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.timing import Timing, timing_of
from adaptdrive.util.errors import RefusedError
from tests.loopback_port import LoopbackPort
from tests.support import text_of


class QueuedPort(LoopbackPort):
    """A port in whose kernel readings wait while the process does not run.

    Attributes:
        waiting: Readings that were not read yet.
        on_delivery: Called with each reading before the daemon gets it.
    """

    def __init__(
        self, commanded: Callable[[Command], None], modulus: int | None, timing: Timing
    ) -> None:
        super().__init__(commanded, counter_modulus=modulus, timing=timing)
        self.waiting: deque[Reading] = deque(maxlen=64)
        self.on_delivery: Callable[[Reading], None] = lambda _: None

    def deliver(self, reading: Reading) -> None:
        """Hand a reading over."""
        if self.up:
            self.on_delivery(reading)
        super().deliver(reading)

    def open(self, listener: Daemon) -> None:
        """Put the daemon on the bus."""
        self._listener, self._up = listener, True

    @property
    def up(self) -> bool:
        """Whether the bus is there."""
        return self._up

    def catch_up(self) -> None:
        """Hand over what waits, oldest first."""
        while self.waiting:
            self.deliver(self.waiting.popleft())


class _Timer:
    """The daemon's timer, which expires when the test lets time pass."""

    def __init__(self) -> None:
        self.deadline_s = math.inf

    def arm(self, deadline_s: float) -> None:
        self.deadline_s = deadline_s

    def close(self) -> None:
        self.deadline_s = math.inf


class DaemonByHand:
    """A daemon that runs at each call of the test only.

    Attributes:
        now: The time that the daemon reads, in s.
        ran_s: When its timer last expired: it ran then, sent a command or none.
        port: Its bus.
        hub: Where it publishes its reports.
        revise: What becomes of each decision of the slow loop.
    """

    def __init__(
        self, configuration: Configuration, commanded: Callable[[Command], None], now: float
    ) -> None:
        """Build the daemon and open its bus.

        Args:
            configuration: As it would be read from a file.
            commanded: Called with each command that reaches the bus.
            now: Monotonic time.
        """
        controller = Controller(controller_settings(configuration), build_load(configuration))
        modulus = 65536 if configuration.signals.counter is not None else None
        self.now, self.ran_s = now, -math.inf
        self.port = QueuedPort(commanded, modulus, timing_of(configuration))
        self.hub = hub = Hub()
        self._reports = hub.subscribe(Event, LoadReport, size=100_000)
        self.daemon = Daemon(
            port=self.port,
            controller=controller,
            configuration=configuration,
            machine=machine_limits(configuration),
            fast=fast_settings(configuration),
            clock=lambda: self.now,
            hub=hub,
            manager=ServiceManager({}),
        )
        self._timer = _Timer()
        inside: Any = self.daemon
        inside._timer = self._timer
        self.revise: Callable[[Decision], Decision] = lambda decision: decision
        self.port.open(self.daemon)
        inside._opened()

    @property
    def fast(self) -> FastLoop:
        """The fast loop within."""
        return self.daemon._fast

    @property
    def state(self) -> State:
        """Where the state machine is."""
        return self.daemon._machine.state

    @property
    def trip(self) -> str | None:
        """Cause of the latched trip."""
        return text_of(self.daemon._machine.trip)

    def wait(self, until_s: float) -> None:
        """Let time pass; the timer expires when it is due."""
        while self._timer.deadline_s < until_s:
            self.now = self.ran_s = max(self.now, self._timer.deadline_s)
            self.daemon._on_deadline(self._timer.deadline_s)
        self.now = max(self.now, until_s)

    def sleep(self, until_s: float) -> None:
        """Let time pass without running at all."""
        self.now = max(self.now, until_s)

    def decide(self) -> int:
        """Have the slow loop decide on what waits; how many decisions that made."""
        daemon, made = self.daemon, 0
        with contextlib.suppress(asyncio.QueueEmpty):
            while True:
                snapshot = daemon._snapshots.get_nowait()
                daemon._fast.deliver(snapshot, self.revise(daemon._decide(snapshot)))
                made += 1
        return made

    def accepts(self, request: Request) -> bool:
        """Carry a request out; False when it is refused."""
        work = self.daemon.execute(request)
        try:
            work.send(None)
        except StopIteration:
            return True
        except RefusedError:
            return False
        raise AssertionError("the request waits for something")

    def heard(self) -> list[Event | LoadReport]:
        """What has been reported since the last call."""
        return [one for one in self._reports.drain() if isinstance(one, Event | LoadReport)]
