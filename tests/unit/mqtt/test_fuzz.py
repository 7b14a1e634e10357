"""Random payloads on every command topic, in virtual time: only `disable` and valid commands act.

What is valid is judged by the published JSON Schema, which is not the code that reads commands.
"""

from __future__ import annotations

import json
import math
import os
import random
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from adaptdrive.control.signals import Mode
from adaptdrive.mqtt.commands import FORMS, PING
from adaptdrive.mqtt.contract import encode
from adaptdrive.mqtt.desk import Desk, LineRation, ReplyMemory
from adaptdrive.runtime.reports import Hub, State
from adaptdrive.runtime.requests import REQUESTS, Disable, Enable, Request, SetMode
from adaptdrive.runtime.state_machine import Machine
from adaptdrive.safety.trips import Trip
from tests.unit.mqtt.contract import validators
from tests.unit.runtime.test_machine import LIMITS

SEED = 20260
PAYLOADS = int(os.environ.get("PAYLOADS", "2000"))
"""On each topic; the long form sets 100,000 in the environment."""
NOW = datetime(2026, 1, 1, tzinfo=UTC)
LATER = (NOW + timedelta(seconds=9)).isoformat()
VALID: dict[str, Any] = {
    "setpoint": 3.1,
    "waveform": {"shape": "sine", "low": 3.0, "high": 3.2, "period_s": 60.0},
    "mode": "adaptive",
    "voltage": 300.0,
    "pole": 0.7,
}
STRANGE: tuple[Any, ...] = (
    *(None, True, 0, -1, 1e308, -1e-308, 2**70, "", "on", "NaN", "\x00", "💥" * 9, [], {}, [[]]),
    *(math.nan, math.inf, -math.inf, 4.4999, 4.5001, 0.5, "<script>", "2026-01-01T00:00:00"),
)
KEYS = ("id", "value", "expires", "user", "shape", "low", "high", "period_s", "hold_s", "x", "")
VALIDATORS = validators()


class VirtualHost:
    """A machine that carries out what it is asked, and notes how often it was stopped."""

    def __init__(self) -> None:
        self.stops = 0
        self.machine = Machine(LIMITS)

    def begin(self, state: State) -> None:
        """Take a running or an idle machine."""
        self.machine = Machine(LIMITS)
        if state is State.RUNNING:
            self.machine.carry_out(Enable(), 1, 3.0, None)
            self.machine.advance(2, 0.0)
            self.machine.advance(3, LIMITS.floor_V)
            self.machine.carry_out(SetMode(Mode.MANUAL), 4, 3.0, None, 300.0)

    @property
    def present(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self.machine).items() if name != "_limits"}

    async def execute(self, request: Request) -> State:
        self.machine.carry_out(request, 5, 3.0, None, 300.0)
        return self.machine.state

    def trip(self, cause: Trip) -> None:
        raise AssertionError(cause)

    def stop(self) -> State:
        self.stops += 1
        self.machine.carry_out(Disable(), 5, 3.0, None)
        self.machine.confirm_stop()
        return self.machine.state


def document(chance: random.Random, depth: int = 3) -> Any:
    """Any JSON document."""
    if depth == 0 or chance.random() < 0.5:
        return chance.choice(STRANGE)
    if chance.random() < 0.3:
        return [document(chance, depth - 1) for _ in range(chance.randrange(3))]
    return {key: document(chance, depth - 1) for key in chance.sample(KEYS, chance.randrange(5))}


def spoilt(chance: random.Random, verb: str, identity: str) -> Any:
    """A command with something dropped, replaced or added; seldom nothing."""
    command: dict[str, Any] = {"id": identity}
    if verb in VALID:
        command["value"] = json.loads(json.dumps(VALID[verb]))
    if chance.random() < 0.3:
        command["expires"] = chance.choice([LATER, NOW.isoformat(), "soon"])
    place = command
    if isinstance(command.get("value"), dict) and chance.random() < 0.7:
        place = command["value"]
    match chance.randrange(4):
        case 0:
            place.pop(chance.choice(list(place)))
        case 1 | 2:
            place[chance.choice(list(place))] = chance.choice(STRANGE)
        case _:
            place[chance.choice(KEYS)] = chance.choice(STRANGE)
    return command


def junk(chance: random.Random, verb: str, identity: str) -> bytes:
    """Any payload."""
    kind = chance.random()
    if kind < 0.2:
        return chance.randbytes(chance.randrange(40))
    written = document(chance) if kind < 0.5 else spoilt(chance, verb, identity)
    raw = bytearray(json.dumps(written, ensure_ascii=chance.random() < 0.5).encode())
    if kind > 0.9:
        raw[chance.randrange(len(raw))] = chance.randrange(256)
    return bytes(raw)


def fits(verb: str, raw: bytes) -> bool:
    """Whether the published schema allows a payload; the last of equal keys counts."""
    try:
        content = json.loads(raw)
    except ValueError:
        return False
    return verb in REQUESTS and VALIDATORS[f"command/{verb}"].is_valid(content)


def desk_of(host: VirtualHost) -> Desk:
    clock: Callable[[], float] = lambda: 0.0  # noqa: E731
    memory = ReplyMemory((), lambda _identity, _body: None, clock)
    hub, ration = Hub(), LineRation(clock, lines=0)
    return Desk(host, memory, lambda: host.machine.state, lambda: NOW, ration,
                report=hub.publish, kept=hub.kept, shutting_down=lambda: False)  # fmt: skip


@pytest.mark.parametrize("state", [State.STANDBY, State.RUNNING])
@pytest.mark.parametrize("verb", [*FORMS, "explode", ""])
async def test_random_payloads_change_nothing_unless_they_are_valid(
    tmp_path: Path, verb: str, state: State
) -> None:
    chance, host = random.Random(f"{SEED} {verb} {state}"), VirtualHost()
    desk = desk_of(host)
    host.begin(state)
    before, changed = host.present, 0
    for number in range(PAYLOADS // 2):
        raw = junk(chance, verb, str(number))
        command = desk.receive(verb, raw, retained=chance.random() < 0.05)
        reply = await desk.answer(command)
        encode(reply)
        if verb == "disable":
            assert reply.accepted
            assert not host.machine.energised
        elif not reply.accepted or verb == PING:
            assert host.present == before, raw
        elif host.present != before:  # a repeat of an id is accepted and does nothing
            assert not command.retained
            assert fits(verb, raw), raw
            changed += 1
            host.begin(state)
    assert host.stops == (PAYLOADS // 2 if verb == "disable" else 0)
    assert changed < PAYLOADS // 4
