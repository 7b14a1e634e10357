"""How long a daemon and a command take to start, in turn with the imports of the script."""

from __future__ import annotations

import select
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

from tools.benchmarks.paired.pairs import Effort, Row, Turn
from tools.benchmarks.site import broker, start_daemon
from tools.benchmarks.tools import ROOT, bus_ports, bus_socket, is_command

LIBRARIES = "import aiomqtt, can, cantools, crccheck"
IMPORTS = "the script's imports"
MOTOR = ROOT / "deploy" / "examples" / "motor.toml"


def rows(environments: dict[str, dict[str, str]], effort: Effort) -> Iterator[Row]:
    """Rows of all builds."""
    with TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        _, port = stack.enter_context(broker(folder))
        for build, environment in environments.items():
            home = folder / build
            turns = [_turn(home, port, environment) for _ in range(effort.turns)]
            first, check = zip(*turns, strict=True)
            yield Row("start to first command", build, "s", IMPORTS, first, most=0.6)
            yield Row("`adaptdrive check motor.toml`", build, "s", IMPORTS, check)


def _turn(folder: Path, broker_port: int, environment: dict[str, str]) -> list[Turn]:
    """Start the daemon and the command, between imports of the libraries of the script."""
    before_s = _duration_s(environment, "-c", LIBRARIES)
    ours_s = (
        _to_command_s(folder, broker_port, environment),
        _duration_s(environment, "-m", "adaptdrive.cli", "check", str(MOTOR)),
    )
    after_s = _duration_s(environment, "-c", LIBRARIES)
    return [Turn(one, before_s, after_s) for one in ours_s]


def _duration_s(environment: dict[str, str], *words: str) -> float:
    began_s = time.monotonic()
    command = [sys.executable, *words]
    subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL)
    return time.monotonic() - began_s


def _to_command_s(folder: Path, broker_port: int, environment: dict[str, str]) -> float:
    """From the start of the process to its first command on the bus."""
    with ExitStack() as stack:
        (bus_port,) = bus_ports(1)
        bus = stack.enter_context(bus_socket(bus_port))
        began_s = time.monotonic()
        start_daemon(stack, folder, bus_port, broker_port, {}, environment)
        while select.select([bus], [], [], 30.0)[0]:
            if is_command(bus.recv(512)):
                return time.monotonic() - began_s
        raise RuntimeError("no command on the bus")
