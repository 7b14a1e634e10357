"""An experiment carried out on a running drive, over MQTT, with readings of which none is old.

Each voltage has a time to live: when this program or its connection dies, the drive trips.
"""

import asyncio
import math
from collections.abc import AsyncGenerator, AsyncIterator, Callable
from contextlib import aclosing, suppress
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from adaptdrive.commissioning.course import ExperimentCourse, Samples
from adaptdrive.mqtt.client import DriveStatus, NoAnswerError, read_status, send_command, telemetry
from adaptdrive.mqtt.commands import number, part
from adaptdrive.mqtt.connection import Broker
from adaptdrive.mqtt.contract import Reply
from adaptdrive.tui.terminal import whole
from adaptdrive.util.errors import AdaptdriveError, CommissionError, first_error

# The readings of an experiment: none is old, and their time passes as it does here.

_SILENCE_S = 4.0
"""Longest time without telemetry, and without a measurement in it; largest step of its time."""

_SAME_S = 0.03
"""Largest difference of the published times of one measurement; telemetry comes 0.1 s apart."""

_SLEW = 1.0e-3
"""Largest rate of a clock that is kept right, twice what NTP allows, as a share of the time."""


@dataclass(frozen=True, slots=True)
class FastReading:
    """One message of the fast loop.

    Attributes:
        time_s: Its time, in seconds of the wall clock.
        boost_voltage_V: v_bst.
        output: The regulated quantity.
        age_s: Time since they were measured.
        bridge: Whether the load is commanded on.
    """

    time_s: float
    boost_voltage_V: float
    output: float
    age_s: float
    bridge: bool

    @property
    def measured_s(self) -> float:
        """Time of the measurement, which several messages may show."""
        return self.time_s - self.age_s


def reading_of(content: dict[str, Any]) -> FastReading | None:
    """Return the reading of a message of `telemetry/drive`, None where something is missing."""
    try:
        time_s = datetime.fromisoformat(content["time"]).timestamp()
    except (KeyError, TypeError, ValueError, OverflowError):
        return None
    measured = number(content.get("boost_voltage_V")), number(content.get("output"))
    values = *measured, number(content.get("age_s"))
    if not all(map(math.isfinite, values)):
        return None
    return FastReading(time_s, *values, bridge=bool(part(content, "command").get("bridge")))


async def fast_readings(broker: Broker, drive: str) -> AsyncGenerator[FastReading, None]:
    """Yield one reading for each measurement of a drive, in the order of their times.

    A drive that is polled slowly shows a measurement in several messages. One of them is yielded
    again where its bridge was switched.

    Args:
        broker: The broker.
        drive: Name of the drive.

    Raises:
        NoAnswerError: The newest measurement is too old.
        CommissionError: A clock was set.
    """
    now = asyncio.get_running_loop().time
    last_s, measured_s = -math.inf, now()
    first: tuple[float, float] | None = None
    last: FastReading | None = None
    async with aclosing(telemetry(broker, drive)) as messages:
        while True:
            name, content = await _next(messages, drive)
            reading = reading_of(content) if name == "drive" else None
            if reading is not None:
                now_s = now()
                first = first or (reading.time_s, now_s)
                _require_steady_clock(drive, first, (reading.time_s, now_s))
                if reading.time_s > last_s:
                    last_s, measured_s = reading.time_s, now_s - reading.age_s
                    if last is None or _is_new(reading, last):
                        last = reading
                        yield reading
            if now() - measured_s > _SILENCE_S:
                silence = f"no measurement for {_SILENCE_S:g} s: adaptdrive probe shows why"
                raise NoAnswerError(drive, silence)


async def _next(
    messages: AsyncIterator[tuple[str, dict[str, Any]]], drive: str
) -> tuple[str, dict[str, Any]]:
    """Return the next message, which must come in time."""
    try:
        async with asyncio.timeout(_SILENCE_S):
            return await anext(messages)
    except TimeoutError as problem:
        raise NoAnswerError(drive, f"no telemetry for {_SILENCE_S:g} s") from problem


def _is_new(reading: FastReading, last: FastReading) -> bool:
    """Return whether a reading shows another measurement than the last one, or another bridge."""
    return reading.measured_s - last.measured_s > _SAME_S or reading.bridge != last.bridge


def _require_steady_clock(
    drive: str, first: tuple[float, float], last: tuple[float, float]
) -> None:
    """Make sure that the time of the readings has not left the clock since the first reading.

    What a clock may drift until then, or be slewed, does not count. Of both readings the time, and
    that of the arrival by a clock that nobody sets, are given.
    """
    elapsed_s = last[1] - first[1]
    lead_s = last[0] - first[0] - elapsed_s
    lead_s = math.copysign(max(0.0, abs(lead_s) - _SLEW * elapsed_s), lead_s)
    if abs(lead_s) > _SILENCE_S:
        raise CommissionError(
            f"the time of {drive}'s telemetry moved by {lead_s:+.4g} s against this program's "
            "clock: a clock was set, or messages come late"
        )


# An experiment carried out on a running drive, over MQTT.

HOLD_S = 5.0
"""Time to live of a voltage."""

_REFRESH_S = 1.0

_START_S = 60.0
"""Longest time from `enable` to state `running`."""

_POLL_S = 0.3

_ENERGISED = frozenset({"starting", "running"})


class Guide:
    """Commands one drive for an experiment.

    Attributes:
        drive: Its name.
        unstopped: Why the stop at the end is not confirmed; empty where it is.
    """

    def __init__(self, broker: Broker, drive: str, timeout_s: float) -> None:
        """Name a drive; nothing is connected yet.

        Args:
            broker: The broker.
            drive: Name of the drive.
            timeout_s: Longest wait for a reply.
        """
        self._broker = broker
        self.drive = drive
        self._timeout_s = timeout_s
        self.unstopped = ""
        self._wanted_V = math.nan
        self._changed = asyncio.Event()

    async def watch_standby(self, duration_s: float) -> Samples:
        """Return what the sensors show while the drive is off.

        Args:
            duration_s: Time to watch.

        Raises:
            CommissionError: The drive is not in standby.
            NoAnswerError: No answer.
        """
        await self._standby()
        samples = Samples()
        async with aclosing(fast_readings(self._broker, self.drive)) as readings:
            async for one in readings:
                samples.append(one.measured_s, one.boost_voltage_V, one.output)
                if one.measured_s - samples.times_s[0] >= duration_s:
                    break
        return samples

    async def carry_out(
        self, experiment: ExperimentCourse, show: Callable[[FastReading, float], None]
    ) -> None:
        """Enable the drive in mode manual and run an experiment; leave the drive off in any case.

        Args:
            experiment: The experiment.
            show: Takes each reading and the voltage that is asked for.

        Raises:
            AdaptdriveError: The experiment cannot continue, or the drive tripped or was disabled.
        """
        before = await self._standby()
        try:
            await self.ask("mode", "manual")
            await self.ask("enable")
            await self._await_running(coasting=True)
            # a load at rest coasts until it is asked for a voltage
            await self.ask("voltage", experiment.voltage_V, hold_s=HOLD_S)
            await self._await_running(coasting=False)
            await self._follow(experiment, show)
        finally:
            leaving = self._leave(str(before.get("mode", "fixed")))
            await whole(leaving, complete=experiment.done)

    async def _follow(
        self, experiment: ExperimentCourse, show: Callable[[FastReading, float], None]
    ) -> None:
        """Run the experiment; the voltage is asked for meanwhile, so that no reading waits."""
        self._wanted_V = experiment.voltage_V
        try:
            async with asyncio.TaskGroup() as group:
                asking = group.create_task(self._keep_asking())
                await self._feed(experiment, show)
                asking.cancel()
        except BaseExceptionGroup as problems:
            known, others = problems.split(AdaptdriveError)
            if known is None or others is not None:
                raise
            raise first_error(known) from None

    async def _feed(
        self, experiment: ExperimentCourse, show: Callable[[FastReading, float], None]
    ) -> None:
        """Take readings until the experiment is complete."""
        async with aclosing(fast_readings(self._broker, self.drive)) as readings:
            async for one in readings:
                if not one.bridge:
                    raise CommissionError(await self._end())
                voltage_V = experiment.take(one.measured_s, one.boost_voltage_V, one.output)
                if voltage_V != self._wanted_V:
                    self._wanted_V = voltage_V
                    self._changed.set()
                show(one, voltage_V)
                if experiment.done:
                    return

    async def _keep_asking(self) -> None:
        """Ask for the last voltage whenever it changes, and before its time is over."""
        while True:
            self._changed.clear()
            await self.ask("voltage", self._wanted_V, hold_s=HOLD_S)
            with suppress(TimeoutError):
                async with asyncio.timeout(_REFRESH_S):
                    await self._changed.wait()

    async def _await_running(self, *, coasting: bool) -> None:
        """Wait until the drive runs, with its load fed unless it may coast."""
        now = asyncio.get_running_loop().time
        end_s = now() + _START_S
        while True:
            state = await self._state()
            if state["state"] == "running" and (coasting or not state.get("coasting")):
                return
            if state["state"] not in _ENERGISED:
                raise CommissionError(await self._end())
            if now() > end_s:
                raise CommissionError(f"{self.drive} is not running {_START_S:g} s after enable")
            await asyncio.sleep(_POLL_S)

    async def _end(self) -> str:
        """Return why the drive is off."""
        state = await self._state()
        why = state.get("trip") or "disabled by another operator"
        return f"{self.drive} is {state.get('state')}: {why}"

    async def _leave(self, mode: str) -> None:
        """Bring the drive into its safe state, and its mode back."""
        try:
            async with asyncio.timeout(HOLD_S):
                await self.ask("disable")
        except (AdaptdriveError, TimeoutError) as problem:
            why = str(problem) or f"no reply within {HOLD_S:g} s"
            self.unstopped = (
                f"the stop is unanswered ({why}): where {self.drive} is energised, it trips "
                f"within {HOLD_S:g} s of its last voltage. Look at it, and disable it"
            )
            return
        with suppress(AdaptdriveError):
            await self.ask("mode", mode)

    async def _standby(self) -> dict[str, Any]:
        """Return the state, which must be standby: another operator may have enabled the drive."""
        state = await self._state()
        if state.get("state") != "standby":
            raise CommissionError(
                f"{self.drive} is {state.get('state')}: commissioning begins in standby; "
                f"adaptdrive disable {self.drive}, or reset"
            )
        return state

    async def _state(self) -> dict[str, Any]:
        status = await self.status()
        if not status.online or status.state is None:
            raise NoAnswerError(self.drive, "it is not online")
        return status.state

    async def status(self) -> DriveStatus:
        """Return state and telemetry of the drive.

        Raises:
            NoAnswerError: No state in time, or no broker.
        """
        return await read_status(self._broker, self.drive, self._timeout_s)

    async def send(self, verb: str, value: object = None, **fields: object) -> Reply:
        """Send a command, with a value and further fields, and return the reply.

        Raises:
            NoAnswerError: No reply in time, or no broker.
        """
        return await send_command(self._broker, self.drive, verb, value, self._timeout_s, **fields)

    async def ask(self, verb: str, value: object = None, **fields: object) -> None:
        """Send a command that the drive must accept.

        Raises:
            CommissionError: The drive refuses it, or is off when it is asked for a voltage.
            NoAnswerError: As above.
        """
        reply = await self.send(verb, value, **fields)
        if reply.accepted:
            return
        if verb == "voltage" and (await self._state()).get("state") not in _ENERGISED:
            raise CommissionError(await self._end())
        raise CommissionError(f"{self.drive} refused {verb}: {reply.reason}")
