"""Commissioning of one unknown load on each kind of bus, with real processes in real time.

    .venv/bin/python -m tools.benchmarks.commission_buses [LOAD-BUS ...]

As a user would: `adaptdrive init` writes the configuration, its model stays that of the example,
and the simulated drive has another load. Broker, drive, daemon and the command are processes of
their own, drive and daemon with real-time priority where the machine grants it; buses are
multicast on the loopback interface, TCP and a pseudo-terminal.
"""

from __future__ import annotations

import contextlib
import os
import re
import socket
import subprocess
import sys
import tempfile
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path

from tests.support import free_port, prefer

LONGEST_S = 1800.0
START_S = 300.0
STALE_S = 1.0
HEARTBEAT_TIMEOUT_S = 0.5
"""Longer than in the examples: the machine may run others."""

BUSES = ("can", "modbus-tcp", "modbus-rtu", "canopen")
MOTOR = {"gain": 0.0085, "tau_motor_s": 0.9, "tau_filter_s": 0.35}
BATH = {"resistance_K_per_W": 0.0065, "tau_s": 5.2}
BATTERY = {"internal_Ohm": 0.3, "relaxation_Ohm": 0.5, "relaxation_s": 3.0}


@dataclass(frozen=True, slots=True)
class Case:
    """A load on a bus.

    Attributes:
        kind: Kind of load.
        bus: Kind of bus.
        load: Its `[load.model]`.
        noise: Standard deviation of a sample, in the unit of the output.
        patience_s: Shortest wait for a response.
    """

    kind: str
    bus: str
    load: dict[str, float]
    noise: float
    patience_s: float

    @property
    def name(self) -> str:
        """Name of the drive: cases may run side by side."""
        return f"{self.kind}-{self.bus}"


def cases() -> dict[str, Case]:
    """Return each load on each bus."""
    loads = (
        ("motor", MOTOR, 0.002, 2.0),
        ("bath", BATH, 0.01, 4.0),
        ("battery", BATTERY, 0.005, 4.0),
    )
    found = [
        Case(kind, bus, load, noise, patience_s)
        for kind, load, noise, patience_s in loads
        for bus in BUSES
    ]
    return {case.name: case for case in found}


def main() -> None:
    known = cases()
    for name in sys.argv[1:] or known:
        with tempfile.TemporaryDirectory() as folder:
            sys.stdout.write(f"{name}: {commissioned(known[name], Path(folder))}\n")
            sys.stdout.flush()


def commissioned(case: Case, folder: Path) -> str:
    """Commission a load; what was found, or why not."""
    broker = free_port(socket.SOCK_STREAM)
    config, true = configurations(case, folder, broker)
    address = f"127.0.0.1:{broker}"
    options = ["--noise", str(case.noise)]
    if case.bus != "canopen":  # whose drive watches a heartbeat
        options += ["--command-timeout", "1.0"]
    with contextlib.ExitStack() as stack:
        start(stack, folder, ["mosquitto", "-p", str(broker)])
        simulated = ["-m", "adaptdrive_sim", "device", str(true), "--broker", address]
        device = start(stack, folder, [sys.executable, *simulated, *options])
        daemon = start(stack, folder, [sys.executable, "-m", "adaptdrive.cli", "run", str(config)])
        await_online(case.name, address)
        for process in (device, daemon):
            if process.poll() is not None:
                return f"{process.args!r} ended at once"
            prefer(process)
        began_s = time.monotonic()
        done = command(
            *("commission", case.name, "--config", str(config), "--yes", "--write"),
            *("--patience", str(case.patience_s), "--broker", address),
            folder=folder,
        )
        took_s = time.monotonic() - began_s
    if done.returncode != 0:
        return f"refused after {took_s:.0f} s: {(done.stdout + done.stderr).strip()[-300:]}"
    model = tomllib.loads(config.read_text(encoding="utf-8"))["load"]["model"]
    found = ", ".join(f"{name} {model[name]:.4g} ({value:g})" for name, value in case.load.items())
    return f"{took_s:.0f} s, found (true): {found}"


def configurations(case: Case, folder: Path, broker: int) -> tuple[Path, Path]:
    """Write the daemon's configuration, and that of the drive with the true load."""
    words = ("init", case.kind, "--bus", case.bus, "--name", case.name, "--directory", str(folder))
    made = command(*words, "--yes", folder=folder)
    if made.returncode != 0:
        raise SystemExit(made.stderr)
    config = folder / f"{case.name}.toml"
    changes = {"stale_s": str(STALE_S)}
    if case.bus in {"can", "canopen"}:
        changes["udp_port"] = str(free_port(socket.SOCK_DGRAM))
    if case.bus == "canopen":
        changes["heartbeat_timeout_s"] = str(HEARTBEAT_TIMEOUT_S)
    text = changed(config.read_text(encoding="utf-8"), changes)
    head, mqtt, tail = text.partition("[mqtt]")
    text = head + mqtt + changed(tail, {"port": str(broker)})
    if case.bus == "modbus-tcp":
        text = changed(text, {"port": str(free_port(socket.SOCK_STREAM))}, 1)
    config.write_text(text, encoding="utf-8")
    true = folder / "true.toml"
    true.write_text(changed(text, {k: str(v) for k, v in case.load.items()}), encoding="utf-8")
    return config, true


def changed(text: str, values: dict[str, str], count: int = 0) -> str:
    """A configuration with other values."""
    for key, value in values.items():
        text, found = re.subn(rf"(?m)^{key} = \S+", f"{key} = {value}", text, count=count)
        if not found:
            raise SystemExit(f"{key} is not in the configuration")
    return text


def start(stack: contextlib.ExitStack, folder: Path, words: list[str]) -> subprocess.Popen[bytes]:
    """Start a process that ends with the stack."""
    with (folder / f"{len(list(folder.iterdir()))}.log").open("wb") as log:
        environment = os.environ | {"STATE_DIRECTORY": str(folder)}
        process = subprocess.Popen(
            words, cwd=folder, stdout=log, stderr=subprocess.STDOUT, env=environment
        )
    stack.callback(process.wait)
    stack.callback(process.terminate)
    return process


def await_online(name: str, address: str) -> None:
    """Wait until the daemon answers."""
    end_s = time.monotonic() + START_S
    while command("status", name, "--broker", address).returncode != 0:
        if time.monotonic() > end_s:
            raise SystemExit(f"no daemon within {START_S:g} s")
        time.sleep(1.0)


def command(*words: str, folder: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run `adaptdrive` to its end."""
    return subprocess.run(
        [sys.executable, "-m", "adaptdrive.cli", *words],
        cwd=folder,
        check=False,
        capture_output=True,
        text=True,
        timeout=LONGEST_S,
    )


if __name__ == "__main__":
    main()
