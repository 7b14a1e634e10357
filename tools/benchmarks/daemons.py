"""How many daemons two cores hold, and what each of them costs there."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from tools.benchmarks.rows import Extent, Row
from tools.benchmarks.site import Running, await_broker, broker, enable, runs, start_daemon
from tools.benchmarks.tools import PRIORITY, bus_ports, cpu_s, process

WANTED = 24
COUNTS = (8, 16, 24)
LONG_S = 60.0


@dataclass(frozen=True)
class Census:
    """So many daemons at work for some time.

    Attributes:
        missed: Half cycles without a tick, and stand-in ticks, of all of them.
        late: Half cycles that were played too late, which no daemon can be blamed for.
        cpu_share: CPU share of one daemon in the mean, in percent.
    """

    missed: int
    late: int
    cpu_share: float


def rows(extent: Extent) -> Iterator[Row]:
    """All rows of this file."""
    counts = extent.pick(COUNTS, COUNTS[:-1], (2,))
    held, missed = 0, ""
    for count in counts:
        seconds = extent.pick(LONG_S if count == WANTED else 15.0, 10.0, 2.0)
        census = measure(count, seconds)
        note = f"{census.missed} missed or stand-in ticks in {seconds:.0f} s"
        note += f"; {census.late} half cycles were played late"
        yield Row(f"CPU share of each of {count} daemons", census.cpu_share, "%", note=note)
        missed = note
        if not census.missed:
            held = count
    target = f"at least {WANTED}"
    met = held >= WANTED
    tried = ", ".join(map(str, counts))
    note = f"on {os.cpu_count()} CPUs, without recorders; of {tried} tried, the last: {missed}"
    yield Row(
        "daemons at 120 Hz without a missed tick", held, "", target=target, met=met, note=note
    )


def measure(count: int, seconds: float) -> Census:
    """Run so many daemons with their drives' frames replayed."""
    with TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        _, broker_port = stack.enter_context(broker(folder))
        daemons = []
        for i, bus_port in enumerate(bus_ports(count)):
            changes = {"drive.name": f'"d{i}"', "recording.enabled": "false"}
            home = folder / f"d{i}"
            daemons.append(start_daemon(stack, home, bus_port, broker_port, changes))
        late = folder / "late"
        run_drives(stack, daemons, [], late)
        return _count(daemons, broker_port, late, seconds)


def run_drives(stack: ExitStack, daemons: list[Running], others: list[int], late: Path) -> None:
    """Replay the frames of the drives, and enable each.

    Args:
        stack: Ends the player.
        daemons: Of the drives d0, d1 and so on.
        others: Further ports on which the frames are played.
        late: Where half cycles that were played too late are counted.
    """
    for daemon in daemons:
        await_broker(daemon)
    ports = ",".join(map(str, [*(daemon.bus_port for daemon in daemons), *others]))
    player = [sys.executable, "-m", "tools.benchmarks.player", ports, str(PRIORITY + 10)]
    stack.enter_context(process([*player, late]))
    for i, daemon in enumerate(daemons):
        enable(daemon, f"d{i}")
        if not runs(daemon):
            log = daemon.log.read_text(encoding="utf-8")
            raise RuntimeError(f"a drive does not run: {log[-2000:]}")
    time.sleep(2.0)


def _count(daemons: list[Running], broker_port: int, late: Path, seconds: float) -> Census:
    pids = [daemon.daemon.pid for daemon in daemons]
    before, late_before = _ticks(broker_port, len(pids)), _lines(late)
    used_s, began_s = sum(map(cpu_s, pids)), time.monotonic()
    time.sleep(seconds)
    used_s, passed_s = sum(map(cpu_s, pids)) - used_s, time.monotonic() - began_s
    after = _ticks(broker_port, len(pids))
    return Census(
        missed=sum(after.values()) - sum(before.values()),
        late=_lines(late) - late_before,
        cpu_share=100.0 * used_s / passed_s / len(pids),
    )


def _lines(path: Path) -> int:
    return len(path.read_text(encoding="utf-8").splitlines())


def _ticks(broker_port: int, count: int) -> dict[str, int]:
    """Missed and stand-in ticks so far, by drive."""
    command = ["mosquitto_sub", "-p", str(broker_port), "-t", "adaptdrive/+/telemetry/drive"]
    command += ["-F", "%t %p", "-C", str(6 * count), "-W", "10"]
    run = subprocess.run(command, check=False, capture_output=True, text=True, timeout=30.0)
    found = {}
    for line in run.stdout.splitlines():
        topic, _, payload = line.partition(" ")
        content = json.loads(payload)
        found[topic] = int(content["missed"]) + int(content["held"])
    if len(found) != count:
        raise RuntimeError(f"{len(found)} of {count} drives were heard")
    return found
