"""Hostile payloads for a daemon on each topic that it reads, over a real broker.

Each command must be answered, and none but `disable` and `ping` may be accepted. Payloads that the
published schema of their topic allows are left out, because the daemon may carry them out. The
daemon takes 200 commands a second: `--minutes 10`, 100,000 on each of 11 topics, lasts two hours.
"""

from __future__ import annotations

import json
import random
import socket
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from adaptdrive.mqtt.commands import FORMS, PING, STOP
from tests.support import MosquittoLauncher, free_port, resident_MiB
from tests.system.daemon.site import Site
from tests.unit.mqtt.contract import validators
from tools.benchmarks.fence import Fence
from tools.benchmarks.hostile import Hostile
from tools.benchmarks.rows import Extent, Row
from tools.benchmarks.tools import cpu_s
from tools.fuzz.mutate import mutated

EACH = 10_000
"""Payloads on each topic for each of `--minutes`."""
SEED = 60
KNOWN = tuple(f"command/{verb}" for verb in FORMS if verb != STOP)
STRANGE = ("command/", "command/explode", "command/setpoint/x", "command/ö", "command/__proto__")
ASKED = "ask/history"
OTHERS = "command/…"
HARMLESS = (OTHERS, ASKED, f"command/{PING}", f"command/{STOP}")
"""Topics on which no payload changes the state in which they are used."""

RETAINED = 0.02
"""Share of the payloads that are published as retained messages."""

SETTINGS = {"interlocks.stale_s": "2.0"}
LASTING = ("state", "mode", "setpoint", "waveform", "pole", "enabled", "voltage_V", "trip")
"""Keys of `state` that only a command or a trip changes."""


@dataclass(frozen=True)
class Outcome:
    """What a storm on one group of topics did.

    Attributes:
        answers: Replies to its payloads.
        seconds: CPU time of the daemon.
        grown_MB: Growth of the daemon's memory from a fifth of the storm to its end.
    """

    answers: int
    seconds: float
    grown_MB: float


def rows(extent: Extent) -> Iterator[Row]:
    """All rows of this file."""
    each = extent.pick(int(EACH * extent.minutes), 200, 5)
    with _site() as site:
        site.run_drive()
        running = {key: site.state[key] for key in LASTING}
        site.ear.close()  # it would write all payloads into a file
        for name in (*KNOWN, OTHERS, ASKED):
            yield _row(name, storm(site, name, each, running), each)
        stopped = running | {"state": "standby", "enabled": False}
        yield _row(f"command/{STOP}", storm(site, f"command/{STOP}", each, stopped), each)
        _require(site.daemon is not None and site.stop_daemon() == 0, "the daemon ended")
        log = (site.folder / "daemon.log").read_text(encoding="utf-8")
        _require("Traceback" not in log, "the log has a traceback")


def _row(name: str, found: Outcome, each: int) -> Row:
    note = f"{found.answers} answers, {found.seconds / each * 1e6:.0f} us of CPU a payload, "
    note += f"memory {found.grown_MB:+.2f} MB in its last four fifths; state unchanged"
    return Row(f"hostile payloads on {name}", each, "", note=note)


def storm(site: Site, name: str, each: int, state: dict[str, Any]) -> Outcome:
    """Publish payloads on a topic, and judge the answers and the state after them."""
    assert site.daemon is not None
    pid, began_s = site.daemon.pid, cpu_s(site.daemon.pid)
    answers, first_MB = 0, 0.0
    with closing(Fence(site.broker_port)) as fence:
        for number, (topic, raw, retain) in enumerate(messages(name, each)):
            if number == each // 5:
                first_MB = resident_MiB(pid)
            fence.send(topic, raw, retain=retain, answered=name != ASKED)
        fence.wait()
        answers = _judged(name, fence.replies)
        fence.forget_retained()
        found = {key: fence.state[key] for key in LASTING}
        _require(found == state, f"{state} became {found} after {name}")
    return Outcome(answers, cpu_s(pid) - began_s, resident_MiB(pid) - first_MB)


def _judged(name: str, replies: list[dict[str, Any]]) -> int:
    for reply in replies:
        verb = name.removeprefix("command/")
        wanted = {STOP: [True], PING: [True, False]}.get(verb, [False])
        _require(reply["accepted"] in wanted, reply)
        _require(reply["accepted"] or bool(reply["reason"]), reply)
    return len(replies)


def messages(name: str, count: int) -> Iterator[tuple[str, bytes, bool]]:
    """Yield topics, payloads that are not valid there, and whether they are to be retained."""
    chance, schemas = random.Random(f"{SEED} {name}"), validators()
    source = Hostile(SEED, KNOWN)
    known = name if name in schemas else "command/setpoint"
    while count:
        raw = _drawn(chance, source, known)
        if name in HARMLESS or not _allowed(schemas[known], raw):
            topic = name if known == name else chance.choice(STRANGE)
            yield topic, raw, chance.random() < RETAINED and topic != ASKED
            count -= 1


def _drawn(chance: random.Random, source: Hostile, name: str) -> bytes:
    """Return a payload with odd values, or one that was damaged after that."""
    raw = source.draw(name if name in KNOWN else chance.choice(KNOWN))
    return mutated(chance, [raw]) if chance.random() < 0.3 else raw


def _allowed(schema: Any, raw: bytes) -> bool:
    try:
        return bool(schema.is_valid(json.loads(raw)))
    except (ValueError, RecursionError):
        return False


def _require(found: bool, what: object) -> None:
    if not found:
        raise AssertionError(what)


@contextmanager
def _site() -> Iterator[Site]:
    """A broker, a simulated drive and its daemon."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        launcher = MosquittoLauncher("/usr/sbin/mosquitto", folder)
        ports = free_port(socket.SOCK_STREAM), free_port(socket.SOCK_DGRAM)
        with closing(Site(folder, launcher, *ports, SETTINGS)) as site:
            site.start("--initial-voltage", "280", "--command-timeout", "1.0")
            yield site
