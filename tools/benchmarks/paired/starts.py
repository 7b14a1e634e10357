"""How long a daemon and a command take to start, in turn with the imports of the script."""

from __future__ import annotations

import select
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from tools.benchmarks.paired.pairs import Effort, Row, take_turns
from tools.benchmarks.site import broker, start_daemon
from tools.benchmarks.tools import ROOT, bus_ports, bus_socket, is_command

IMPORTS = "import aiomqtt, can, cantools, crccheck"
SCRIPT = "imports of the script"
MOTOR = ROOT / "deploy" / "examples" / "motor.toml"


def rows(environments: dict[str, dict[str, str]], effort: Effort) -> Iterator[Row]:
    """Rows of all builds."""
    with TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        _, port = stack.enter_context(broker(folder))
        for build, environment in environments.items():
            run = partial(_duration_s, environment)
            imports = partial(run, "-c", IMPORTS)
            first = partial(_to_command_s, folder / build, port, environment)
            check = partial(run, "-m", "adaptdrive.cli", "check", str(MOTOR))
            for title, job, most in (
                ("start to the first command on the bus", first, 0.6),
                ("`adaptdrive check motor.toml`", check, None),
            ):
                turns = take_turns(effort.turns, job, imports)
                yield Row(title, build, "s", SCRIPT, turns, most=most)


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
