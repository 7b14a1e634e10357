"""A measured load put to use: the running daemon takes the file, and adaptive control begins."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress

from adaptdrive.config.services import Mqtt
from adaptdrive.errors import CommissionError
from adaptdrive.operation.conversation import NoAnswerError
from adaptdrive.operation.listener import read_status
from adaptdrive.operation.sender import send_command
from adaptdrive.watch.ending import ended_once, whole

LONGEST_S = 60.0
"""Longest time for the daemon to begin another run, and for the drive to run in it."""

_GAP_S = 0.3


async def put_to_use(broker: Mqtt, drive: str, setpoint: float, timeout_s: float) -> float:
    """Have the daemon take the measured load of its file, and hold a set-point in mode adaptive.

    Args:
        broker: The broker.
        drive: Name of the drive, in standby.
        setpoint: Set-point, one that the experiment has led the output to.
        timeout_s: Longest wait for a reply.

    Returns:
        Time in seconds until the adaptive controller was in force.

    Raises:
        AdaptdriveError: The daemon refuses, or the drive does not run; it is off then.
    """
    began_s = time.monotonic()
    reply = await send_command(broker, drive, "reload", None, timeout_s, measured=True)
    if not reply.accepted:
        raise CommissionError(f"{drive} refused reload: {reply.reason}")
    with ended_once():
        try:
            for verb, value in (("mode", "adaptive"), ("enable", None), ("setpoint", setpoint)):
                await _accepted(broker, drive, verb, value, timeout_s)
            await _in_force(broker, drive, timeout_s)
        except BaseException:
            await whole(_stop(broker, drive, timeout_s), complete=True)
            raise
    return time.monotonic() - began_s


async def _stop(broker: Mqtt, drive: str, timeout_s: float) -> None:
    with suppress(NoAnswerError):
        await send_command(broker, drive, "disable", None, timeout_s)


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
