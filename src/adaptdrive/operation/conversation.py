"""A conversation of an operator with one drive: the connection, its errors, the payloads."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any, TypeVar

import msgspec
from aiomqtt import Client, MqttError, ProtocolVersion

from adaptdrive.config.services import Mqtt
from adaptdrive.errors import NOT_JSON, AdaptdriveError
from adaptdrive.operation.link import connection

T = TypeVar("T")

TELEMETRY_WAIT_S = 1.5
"""Longest wait for telemetry, which comes at least once a second where a drive publishes."""

_SHORTEST_S = 1e-3  # paho takes no wait of 0


class NoAnswerError(AdaptdriveError):
    """A drive, or the broker in front of it, did not answer."""

    def __init__(self, drive: str, problem: str) -> None:
        self.drive = drive
        self.problem = problem
        super().__init__(f"{drive}: {problem}")


def end_of(timeout_s: float) -> float:
    """Return the end of a wait that begins now, by the clock of the event loop."""
    return asyncio.get_running_loop().time() + timeout_s


@asynccontextmanager
async def conversation(broker: Mqtt, drive: str, end_s: float = math.inf) -> AsyncIterator[Client]:
    """Connect to a broker until a time of the event loop; what follows has its own limits."""
    place = f"{broker.host}:{broker.port}"
    wait_s = max(_SHORTEST_S, end_s - asyncio.get_running_loop().time())
    try:
        async with (
            asyncio.timeout_at(end_s) as connecting,
            connection(broker, ProtocolVersion.V311, timeout_s=wait_s) as client,
        ):
            connecting.reschedule(None)
            yield client
    except TimeoutError as problem:
        _pass_on_cancellation(problem)
        silence = f"no answer through {place}; see `adaptdrive list`"
        if connecting.expired():
            silence = f"no answer from broker {place} within {wait_s:.3g} s"
        raise NoAnswerError(drive, silence) from problem
    except (MqttError, OSError) as problem:
        _pass_on_cancellation(problem)
        raise NoAnswerError(drive, f"broker {place}: {problem}") from problem


def decoded(payload: bytes, kind: type[T]) -> T | None:
    """Return what a payload holds, None where it is no JSON of that kind."""
    try:
        return msgspec.json.decode(payload, type=kind)
    except NOT_JSON:
        return None


def json_object(payload: bytes) -> dict[str, Any] | None:
    """Return a JSON object, None for anything else."""
    return decoded(payload, dict[str, Any])


def _pass_on_cancellation(problem: Exception) -> None:
    """A client that fails while it is being cancelled hides the cancellation; bring it back."""
    task = asyncio.current_task()
    if task is not None and task.cancelling():
        raise asyncio.CancelledError from problem
