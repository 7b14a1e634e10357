"""The daemon of one drive: its tasks, their ownership, and their reports."""

import asyncio
import contextlib
import itertools
import math
from collections.abc import Awaitable, Callable

from adaptdrive.config import Configuration
from adaptdrive.control.schedule import TwoRate
from adaptdrive.control.signals import Decision, Mode, Reach, Snapshot
from adaptdrive.devices.port import LAST_STOP_GAP_S, LAST_STOPS, Port
from adaptdrive.runtime import (
    accounts,
    fast_loop,
    program,
    reports,
    requests,
    state_machine,
    tick_support,
)
from adaptdrive.runtime.settings import FastLoopSettings, MachineLimits
from adaptdrive.safety.facts import Reading
from adaptdrive.safety.trips import Trip, TripKind
from adaptdrive.util.clock import TickTimer
from adaptdrive.util.errors import RefusedError

_STOP_GAP_S = 0.004
"""Least time between the safe commands of a flood of stops: half a tick, for the bus's sake."""

_WAITING_AT_MOST = 3
"""Snapshots that may wait for a decision; the drive trips at the next one."""


class Daemon:
    """Runs one drive; the host of its operators.

    Attributes:
        opened: Set once the bus is open.
    """

    def __init__(  # noqa: PLR0913 - it connects all packages, one parameter each
        self,
        *,
        port: Port,
        controller: TwoRate,
        configuration: Configuration,
        machine: MachineLimits,
        fast: FastLoopSettings,
        clock: Callable[[], float],
        hub: reports.Hub,
        manager: tick_support.ServiceManager,
        sensors: Callable[[], tuple[reports.SensorReport, ...]] = tuple,
        recorded: Callable[[], bool] = lambda: True,
        prepare: Callable[[requests.Reload], Awaitable[Callable[[], None]]] | None = None,
    ) -> None:
        """Join port, controller and reports.

        Args:
            port: The drive.
            controller: Its controller.
            configuration: Of the drive.
            machine: Limits of requests.
            fast: Limits and times of the fast loop.
            clock: Monotonic clock in seconds.
            hub: Where reports go.
            manager: The service manager.
            sensors: Gives the state of the separate sensor buses.
            recorded: Gives whether all that is to be recorded is.
            prepare: Prepares another run of this process and returns what ends the present one;
                None where there is none.
        """
        self.opened = asyncio.Event()
        self._prepare = prepare
        self._another_follows = False
        self._sensors = sensors
        self._port = port
        self._configuration = configuration
        self._clock = clock
        self._hub = hub
        self._manager = manager
        self._machine = state_machine.Machine(machine)
        self._programs = program.Programs(self._machine, machine)
        self._fast = fast_loop.FastLoop(port, controller, self._machine, fast, self)
        self._decide = controller.decide
        self._snapshots: asyncio.Queue[Snapshot] = asyncio.Queue(maxsize=_WAITING_AT_MOST)
        self._timer: TickTimer | None = None
        self._support: tick_support.TickSupport | None = None
        self._failure: asyncio.Future[None] | None = None
        self._stopped_s = -math.inf
        self._refused: dict[str, accounts.RefusedShare] = {}
        self._announcer = accounts.Announcer(self._programs, self._fast, hub, manager, recorded)

    async def run(self, stop: asyncio.Event) -> None:
        """Serve the drive until `stop` is set; leave it in its safe state, whatever happens.

        Args:
            stop: Set it for an orderly stop.

        Raises:
            ExceptionGroup: A task died; a `BusError` in it when the bus cannot be opened.
        """
        loop = asyncio.get_running_loop()
        self._failure = loop.create_future()
        self._timer = TickTimer(loop, self._on_deadline)
        self._support = tick_support.TickSupport(self._warn, self._clock)
        self._hub.publish(self._announcer.published)
        try:
            async with asyncio.TaskGroup() as tasks:
                serving = tasks.create_task(self._port.run(self, self._opened), name="port")
                try:
                    await self._work(stop)
                finally:
                    self._announcer.shutting_down = True
                    await self._send_last_stops()
                serving.cancel()
        finally:
            self._timer.close()
            self._support.close()
            self._manager.close()

    async def _work(self, stop: asyncio.Event) -> None:
        """Everything that needs the port; it ends before the port does."""
        async with asyncio.TaskGroup() as tasks:
            working = [
                tasks.create_task(self._decide_for_ever(), name="slow loop"),
                tasks.create_task(self._report(), name="reports"),
                tasks.create_task(self._watch_failure(), name="failure"),
            ]
            await stop.wait()
            await self._shut_down()
            for task in working:
                task.cancel()

    def _on_deadline(self, deadline_s: float) -> None:
        """Run a stand-in tick; the event loop alone would only log its errors."""
        try:
            self._fast.on_deadline(deadline_s)
        except Exception as problem:  # noqa: BLE001 - passed on by the task that watches
            self.fail(problem)

    def fail(self, problem: BaseException) -> None:
        """Make the drive safe at once, and end with an error.

        Args:
            problem: Error that was raised outside of the daemon's tasks.
        """
        text = f"internal error: {problem!r}; keep the log for a report"
        self._machine.latch(Trip(TripKind.INTERNAL_ERROR, text))
        with contextlib.suppress(Exception):  # the first problem counts
            self._fast.send_safe()
        if self._failure is not None and not self._failure.done():
            self._failure.set_exception(problem)

    async def _watch_failure(self) -> None:
        """Raise the error of a callback, so that the daemon ends."""
        if self._failure is not None:
            await self._failure

    def trip(self, cause: Trip) -> None:
        """Trip at once for a cause outside the drive.

        Args:
            cause: What operators read.
        """
        self._machine.latch(cause)
        self._fast.send_safe()
        self._announcer.publish_state()

    def stop(self) -> reports.State:
        """Bring the drive into its safe state at once, whatever it is doing.

        A flood of stops does not fill the bus.

        Returns:
            The state after it.
        """
        now_s = self._clock()
        if self._machine.energised or now_s - self._stopped_s >= _STOP_GAP_S:
            self._send_stop()
            self._stopped_s = now_s
        self._announcer.publish_state()
        return self._machine.state

    def _send_stop(self) -> None:
        """Send only safe commands from now on, and the first one at once."""
        self._machine.disable()
        self._fast.send_safe()

    async def _await_stop(self) -> None:
        """Send safe commands until the drive confirms its stop, or has had the time to."""
        end_s = self._clock() + self._fast.stop_limit_s + LAST_STOP_GAP_S
        for number in itertools.count():
            late = self._clock() > end_s  # judged once more then, however long this process slept
            self._fast.send_safe()
            ended = late or self._machine.state is not reports.State.STOPPING
            if ended and number >= LAST_STOPS:
                break
            await asyncio.sleep(LAST_STOP_GAP_S)

    async def _send_last_stops(self) -> None:
        """Stop the drive more than once: a frame can be lost."""
        for _ in range(LAST_STOPS):
            self._send_stop()
            await asyncio.sleep(LAST_STOP_GAP_S)

    async def execute(self, request: requests.Request) -> reports.State:
        """Carry out an operator's request between two ticks.

        Raises:
            RefusedError: It cannot be carried out; nothing was changed.
        """
        if self._announcer.shutting_down:
            raise RefusedError("the daemon is shutting down")
        request = program.in_own_unit(request, self._configuration.load)
        if isinstance(request, requests.Reload):
            return await self._reload(request)
        if isinstance(request, requests.Reset) and not self._machine.energised:
            await self._port.reset_fault()
        fast, mode = self._fast, self._machine.mode
        output = fast.reading.output if fast.reading is not None else float("nan")
        starts = isinstance(request, requests.Enable | requests.Reset)  # no other one is refused
        cause = (fast.cause or self._refused_cause) if starts else None
        voltage_V = fast.command.boost_reference_V
        self._programs.refuse_by_hand(request)
        if isinstance(request, requests.RunProgram):
            self._programs.carry_out(request, fast.tick, output)
        else:
            self._machine.carry_out(request, fast.tick, output, cause, voltage_V)
        self._take_effect(mode)
        return self._machine.state

    def _take_effect(self, mode: Mode) -> None:
        """Send and publish what the state machine has become between two ticks.

        Args:
            mode: Its mode before.
        """
        if self._machine.commanded_off:
            self._fast.send_safe()
        if self._machine.mode is not mode:
            detail = f"mode {mode} to {self._machine.mode}"
            self._announcer.publish_event("mode", reports.Severity.INFO, detail)
        self._announcer.publish_state()

    async def _reload(self, request: requests.Reload) -> reports.State:
        """Have another run follow this one, which ends; nothing energises the drive meanwhile."""
        if self._prepare is None:
            raise RefusedError("this daemon has no file")
        self._machine.carry_out(request, self._fast.tick, math.nan, None)
        end = await self._prepare(request)
        self._machine.carry_out(request, self._fast.tick, math.nan, None)  # a trip stays latched
        end()
        self._announcer.shutting_down = self._another_follows = True
        return self._machine.state

    def on_reading(self, reading: Reading) -> None:
        """Run the tick of a reading, and report what its port warns of."""
        try:
            self._fast.on_reading(reading)
        except Exception as problem:  # noqa: BLE001 - a port that dies of it would close the bus
            self.fail(problem)
            return
        self._announcer.report_warning(reading.warning, reading.arrival_s)

    def on_bus(self, up: bool, detail: str) -> None:
        """Publish that the bus was lost or came back."""
        self._announcer.report_bus(up=up, detail=detail)

    def now_s(self) -> float:
        """Monotonic time."""
        return self._clock()

    def arm(self, deadline_s: float) -> None:
        """Wake the fast loop at a monotonic time."""
        if self._timer is not None:
            self._timer.arm(deadline_s)

    def met_deadline(self, now_s: float) -> None:
        """Feed the watchdog of the service manager after a tick that was in time."""
        self._manager.feed(now_s)

    def ticked(self, report: reports.TickReport) -> None:
        """Publish a tick that is complete."""
        self._hub.publish(report)
        self._progress(report.measurement.output)
        if self._announcer.outdated:
            self._announcer.publish_state()
        if self._support is not None:
            self._support.ticked(report, idle=not self._announcer.published.enabled)

    def _progress(self, output: float) -> None:
        """Go on with a ramp or a program, between two ticks."""
        mode, tick = self._machine.mode, self._fast.tick
        arrived = self._machine.progress(tick)
        if self._programs.progress(tick, output) or arrived:
            self._take_effect(mode)

    def snapshot_taken(self, snapshot: Snapshot) -> bool:
        """Queue a snapshot for the slow loop; False when that has fallen hopelessly behind."""
        if self._snapshots.full():
            return False
        self._snapshots.put_nowait(snapshot)
        return True

    async def _decide_for_ever(self) -> None:
        """Decide on every snapshot, in order, outside the tick that took it."""
        while True:
            snapshot = await self._snapshots.get()
            self._fast.deliver(snapshot, self._decide(snapshot))

    def decided(self, snapshot: Snapshot, decision: Decision) -> None:
        """Report a decision that took effect, and a change of controller."""
        self._announcer.decision = decision
        self._machine.reach = Reach(decision.reach_low, decision.reach_high)
        self._hub.publish(reports.LoadReport(snapshot, decision, self._clock()))
        if decision.fault:
            self._machine.latch(Trip(TripKind(decision.fault_kind), decision.fault))
            self._fast.send_safe()
        elif decision.complete:  # the load has what it needs: a safe state without a trip
            self._announcer.publish_event("complete", reports.Severity.INFO, "charging is complete")
            self._send_stop()
        self._announcer.publish_state()

    def not_stopped(self, problem: Trip) -> None:
        """Report that the drive has not confirmed its stop in time, for any first cause."""
        self._announcer.publish_alarm("stop", problem)

    def run_ended(self) -> None:
        """Discard what was decided: it is valid for one run only."""
        self._announcer.decision = None
        self._machine.forget_reach()
        while not self._snapshots.empty():
            self._snapshots.get_nowait()

    def _warn(self, kind: str, detail: str) -> None:
        self._announcer.publish_event(kind, reports.Severity.WARNING, detail)

    def _opened(self) -> None:
        self.opened.set()
        self._fast.begin()
        self._manager.ready()
        self._manager.status(f"{self._port.description}: waiting for the drive")

    async def _report(self) -> None:
        while True:
            await asyncio.sleep(1.0 / self._configuration.mqtt.telemetry_Hz)
            report = accounts.drive_report(
                self._fast,
                self._port.statistics,
                self._sensors(),
                self._clock(),
                self._programs.remaining_s(self._fast.tick),
            )
            self._hub.publish(report)
            self._watch_refusals(report)
            self._announcer.publish_state()
            self._announcer.update_manager()

    def _watch_refusals(self, report: reports.DriveReport) -> None:
        """Report a large share of refused frames, and trip where that is configured."""
        ports = {"drive": report.bus} | {one.name: one.bus for one in report.sensors}
        for name, counts in ports.items():
            share = self._refused.setdefault(
                name, accounts.RefusedShare(name, self._configuration.interlocks.refused_share)
            )
            detail = share.add(report.time_s, counts)
            if detail is not None:
                self._warn("refused", detail)
        cause = self._refused_cause
        if cause is not None and self._machine.energised:
            self.trip(cause)

    @property
    def _refused_cause(self) -> Trip | None:
        """Return the first port whose share of refused frames forbids to energise the drive."""
        causes = (share.cause for share in self._refused.values())
        return next((cause for cause in causes if cause is not None), None)

    async def _shut_down(self) -> None:
        """Bring the drive to zero, until it confirms; a frame can be lost, so more than once."""
        self._announcer.shutting_down = True
        if not self._another_follows:
            self._manager.stopping()
        self.stop()
        await self._await_stop()
        self._announcer.publish_state()
