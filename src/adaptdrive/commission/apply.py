"""A measured load put to use: the running daemon takes the file, and adaptive control begins."""

from __future__ import annotations

import asyncio
import time

from adaptdrive.config.services import Mqtt
from adaptdrive.mqtt.client import LIVE_S, NoAnswerError, read_status, send_command
from adaptdrive.tui.terminal import ended_once, tell, whole
from adaptdrive.util.errors import CommissionError

LONGEST_S = 60.0
"""Longest time for the daemon to begin another run, and for the drive to run in it."""

_GAP_S = 0.3


async def put_to_use(
    broker: Mqtt, drive: str, digest: str, setpoint: float, timeout_s: float
) -> float:
    """Have the daemon take the measured load of its file, and hold a set-point in mode adaptive.

    Args:
        broker: The broker.
        drive: Name of the drive, in standby.
        digest: Of the file that was written; a daemon with another one refuses.
        setpoint: Set-point, one that the experiment has led the output to.
        timeout_s: Longest wait for a reply.

    Returns:
        Time in seconds until the adaptive controller was in force.

    Raises:
        AdaptdriveError: The daemon refuses, or the drive does not run; it is off then.
    """
    began_s = time.monotonic()
    await _once(broker, drive, "reload", None, timeout_s, measured=digest)
    with ended_once():
        try:
            await _accepted(broker, drive, "mode", "adaptive", timeout_s)  # it energises nothing
            await _measuring(broker, drive, timeout_s)
            await _once(broker, drive, "enable", None, timeout_s)  # a repeat could undo a stop
            await _accepted(broker, drive, "setpoint", setpoint, timeout_s)
            await _in_force(broker, drive, timeout_s)
        except BaseException:
            await whole(_stop(broker, drive, timeout_s), complete=True)
            raise
    return time.monotonic() - began_s


async def _stop(broker: Mqtt, drive: str, timeout_s: float) -> None:
    try:
        await send_command(broker, drive, "disable", None, timeout_s)
    except NoAnswerError as silence:
        tell(
            f"the stop is unanswered ({silence.problem}): {drive} may run in mode adaptive; look "
            "at it, and disable it"
        )


async def _once(
    broker: Mqtt, drive: str, verb: str, value: object, timeout_s: float, **more: object
) -> None:
    """Send a command, and end where it is refused."""
    reply = await send_command(broker, drive, verb, value, timeout_s, **more)
    if not reply.accepted:
        raise CommissionError(f"{drive} refused {verb}: {reply.reason}")


async def _measuring(broker: Mqtt, drive: str, timeout_s: float) -> None:
    """Wait until the new run has a measurement, without which it refuses `enable`."""
    end_s = time.monotonic() + LONGEST_S
    while True:
        status = await read_status(broker, drive, timeout_s)
        age_s = status.telemetry.get("drive", {}).get("age_s")
        if status.live and age_s is not None and age_s < LIVE_S:
            return
        if time.monotonic() > end_s:
            raise CommissionError(f"{drive} has no measurement after {LONGEST_S:g} s")
        await asyncio.sleep(_GAP_S)


async def _accepted(broker: Mqtt, drive: str, verb: str, value: object, timeout_s: float) -> None:
    """Send a command until it is accepted: the daemon begins another run."""
    end_s = time.monotonic() + LONGEST_S
    while True:
        try:
            reply = await send_command(broker, drive, verb, value, timeout_s)
        except NoAnswerError as silence:
            why = silence.problem
        else:
            if reply.accepted:
                return
            why = reply.reason
        if time.monotonic() > end_s:
            raise CommissionError(f"{drive} refused {verb} for {LONGEST_S:g} s: {why}")
        await asyncio.sleep(_GAP_S)


async def _in_force(broker: Mqtt, drive: str, timeout_s: float) -> None:
    """Wait until the adaptive controller runs the drive."""
    end_s = time.monotonic() + LONGEST_S
    while True:
        state = (await read_status(broker, drive, timeout_s)).state or {}
        if state.get("controller") == "adaptive" and state.get("state") == "running":
            return
        if state.get("trip"):
            raise CommissionError(f"{drive} is {state.get('state')}: {state['trip']}")
        if time.monotonic() > end_s:
            raise CommissionError(f"{drive} is not in adaptive control: {state.get('reason')}")
        await asyncio.sleep(_GAP_S)
