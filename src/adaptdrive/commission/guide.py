"""An experiment carried out on a running drive, over MQTT.

Each voltage has a time to live: when this program or its connection dies, the drive trips.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import aclosing, suppress
from typing import Any

from adaptdrive.commission.experiment import LoadExperiment
from adaptdrive.commission.readings import FastReading, WantedVoltage, fast_readings
from adaptdrive.commission.samples import Samples
from adaptdrive.config.services import Mqtt
from adaptdrive.mqtt.client import NoAnswerError, read_status, send_command
from adaptdrive.tui.terminal import whole
from adaptdrive.util.errors import AdaptdriveError, CommissionError, first_error

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
        unstopped: Why the stop at the end is not confirmed; empty where it is.
    """

    def __init__(self, broker: Mqtt, drive: str, timeout_s: float) -> None:
        """Name a drive; nothing is connected yet.

        Args:
            broker: The broker.
            drive: Name of the drive.
            timeout_s: Longest wait for a reply.
        """
        self._broker = broker
        self._drive = drive
        self._timeout_s = timeout_s
        self.unstopped = ""

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
        async with aclosing(fast_readings(self._broker, self._drive)) as readings:
            async for one in readings:
                samples.append(one.measured_s, one.boost_voltage_V, one.output)
                if one.measured_s - samples.times_s[0] >= duration_s:
                    break
        return samples

    async def carry_out(
        self, experiment: LoadExperiment, show: Callable[[FastReading, float], None]
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
            await self._ask("mode", "manual")
            await self._ask("enable")
            await self._await_running(coasting=True)
            # a load at rest coasts until it is asked for a voltage
            await self._ask("voltage", experiment.course.voltage_V, hold_s=HOLD_S)
            await self._await_running(coasting=False)
            await self._follow(experiment, show)
        finally:
            leaving = self._leave(str(before.get("mode", "fixed")))
            await whole(leaving, complete=experiment.done)

    async def _follow(
        self, experiment: LoadExperiment, show: Callable[[FastReading, float], None]
    ) -> None:
        """Run the experiment; the voltage is asked for meanwhile, so that no reading waits."""
        wanted = WantedVoltage(experiment.course.voltage_V)
        try:
            async with asyncio.TaskGroup() as group:
                asking = group.create_task(self._keep_asking(wanted))
                await self._feed(experiment, wanted, show)
                asking.cancel()
        except BaseExceptionGroup as problems:
            known, others = problems.split(AdaptdriveError)
            if known is None or others is not None:
                raise
            raise first_error(known) from None

    async def _feed(
        self,
        experiment: LoadExperiment,
        wanted: WantedVoltage,
        show: Callable[[FastReading, float], None],
    ) -> None:
        """Take readings until the experiment is complete."""
        async with aclosing(fast_readings(self._broker, self._drive)) as readings:
            async for one in readings:
                if not one.bridge:
                    raise CommissionError(await self._end())
                voltage_V = experiment.take(one.measured_s, one.boost_voltage_V, one.output)
                wanted.change(voltage_V)
                show(one, voltage_V)
                if experiment.done:
                    return

    async def _keep_asking(self, wanted: WantedVoltage) -> None:
        """Ask for the last voltage whenever it changes, and before its time is over."""
        while True:
            wanted.changed.clear()
            await self._ask("voltage", wanted.voltage_V, hold_s=HOLD_S)
            with suppress(TimeoutError):
                async with asyncio.timeout(_REFRESH_S):
                    await wanted.changed.wait()

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
                raise CommissionError(f"{self._drive} is not running {_START_S:g} s after enable")
            await asyncio.sleep(_POLL_S)

    async def _end(self) -> str:
        """Return why the drive is off."""
        return _end(self._drive, await self._state())

    async def _leave(self, mode: str) -> None:
        """Bring the drive into its safe state, and its mode back."""
        try:
            async with asyncio.timeout(HOLD_S):
                await self._ask("disable")
        except (AdaptdriveError, TimeoutError) as problem:
            why = str(problem) or f"no reply within {HOLD_S:g} s"
            self.unstopped = (
                f"the stop is unanswered ({why}): where {self._drive} is energised, it trips "
                f"within {HOLD_S:g} s of its last voltage. Look at it, and disable it"
            )
            return
        with suppress(AdaptdriveError):
            await self._ask("mode", mode)

    async def _standby(self) -> dict[str, Any]:
        """Return the state, which must be standby: another operator may have enabled the drive."""
        state = await self._state()
        if state.get("state") != "standby":
            raise CommissionError(
                f"{self._drive} is {state.get('state')}: commissioning begins in standby; "
                f"adaptdrive disable {self._drive}, or reset"
            )
        return state

    async def _state(self) -> dict[str, Any]:
        status = await read_status(self._broker, self._drive, self._timeout_s)
        if not status.online or status.state is None:
            raise NoAnswerError(self._drive, "it is not online")
        return status.state

    async def _ask(self, verb: str, value: object = None, **fields: object) -> None:
        reply = await send_command(
            self._broker, self._drive, verb, value, self._timeout_s, **fields
        )
        if reply.accepted:
            return
        state = await self._state()
        if verb == "voltage" and state.get("state") not in _ENERGISED:
            raise CommissionError(_end(self._drive, state))
        raise CommissionError(f"{self._drive} refused {verb}: {reply.reason}")


def _end(drive: str, state: dict[str, Any]) -> str:
    why = state.get("trip") or "disabled by another operator"
    return f"{drive} is {state.get('state')}: {why}"
