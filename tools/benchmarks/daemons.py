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

from tests.support import resident_MiB
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
        echo_share: That of a bare echo in Python that heard as many frames meanwhile.
        script_share: That of the script of an afternoon, on the same frames meanwhile.
        resident: Largest resident memory of a daemon.
        script_resident: That of the script.
    """

    missed: int
    late: int
    cpu_share: float
    echo_share: float
    script_share: float
    resident: float
    script_resident: float


def rows(extent: Extent) -> Iterator[Row]:
    """All rows of this file."""
    counts = extent.pick(COUNTS, COUNTS[:-1], (2,))
    held, missed = 0, ""
    for count in counts:
        seconds = extent.pick(LONG_S if count == WANTED else 15.0, 10.0, 2.0)
        census = measure(count, seconds, recording=False)
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


def measure(
    count: int, seconds: float, *, recording: bool, changes: dict[str, str] | None = None
) -> Census:
    """Run so many daemons with their drives' frames replayed."""
    with TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        _, broker_port = stack.enter_context(broker(folder))
        daemons = []
        for i, bus_port in enumerate(bus_ports(count)):
            configured = {
                "drive.name": f'"d{i}"',
                "recording.enabled": str(recording).lower(),
                **(changes or {}),
            }
            home = folder / f"d{i}"
            daemons.append(start_daemon(stack, home, bus_port, broker_port, configured))
        for daemon in daemons:
            await_broker(daemon)
        echo_port, script_port = bus_ports(2)
        of = [sys.executable, "-m"]
        echo = stack.enter_context(process([*of, "tools.benchmarks.echo", str(echo_port)]))
        script = [*of, "tools.benchmarks.afternoon", str(script_port), str(broker_port)]
        beside = stack.enter_context(process([*script, folder / "afternoon.csv"]))
        own = [daemon.bus_port for daemon in daemons]
        ports = ",".join(map(str, [*own, echo_port, script_port]))
        late = folder / "late"
        player = [sys.executable, "-m", "tools.benchmarks.player", ports, str(PRIORITY + 10)]
        stack.enter_context(process([*player, late]))
        _run_drives(daemons)
        return _count(daemons, [echo.pid, beside.pid], broker_port, late, seconds)


def _run_drives(daemons: list[Running]) -> None:
    for i, daemon in enumerate(daemons):
        enable(daemon, f"d{i}")
        if not runs(daemon):
            log = daemon.log.read_text(encoding="utf-8")
            raise RuntimeError(f"a drive does not run: {log[-2000:]}")
    time.sleep(2.0)


def _count(
    daemons: list[Running], others: list[int], broker_port: int, late: Path, seconds: float
) -> Census:
    pids = [daemon.daemon.pid for daemon in daemons]
    before, late_before = _ticks(broker_port, len(pids)), _lines(late)
    used, began_s = [cpu_s(pid) for pid in [*pids, *others]], time.monotonic()
    time.sleep(seconds)
    *own, echoed, scripted = (
        cpu_s(pid) - one for pid, one in zip([*pids, *others], used, strict=True)
    )
    passed_s = time.monotonic() - began_s
    if min(echoed, scripted) <= 0.0:
        raise RuntimeError("the echo or the script of an afternoon has ended")
    after = _ticks(broker_port, len(pids))
    return Census(
        missed=sum(after.values()) - sum(before.values()),
        late=_lines(late) - late_before,
        cpu_share=100.0 * sum(own) / passed_s / len(pids),
        echo_share=100.0 * echoed / passed_s,
        script_share=100.0 * scripted / passed_s,
        resident=max(map(resident_MiB, pids)),
        script_resident=resident_MiB(others[-1]),
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
