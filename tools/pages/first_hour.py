"""The way from `init` to adaptive control: `python -m tools.pages.first_hour` records it.

The commands run for real, with the simulated drive of `pump.dbc`. What they print replaces the
terminal text of docs/own-drive.md, and the figure of the measurement goes to docs/images.
"""

from __future__ import annotations

import os
import re
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import tomlkit

from tests.pseudo_terminal import Screen
from tests.support import free_port
from tests.system.daemon.site import until

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "own-drive.md"
FIGURE = ROOT / "docs" / "images" / "own-drive-load.png"
BLOCK = re.compile(r"```console\n\$ adaptdrive ([^\n]*\bpump\b[^\n]*)\n.*?```", re.DOTALL)
LONGEST_S = 900.0
SHOWN = {"check": (3, 1), "commission": (1, 24), "status": (5, 1)}
"""First and last lines of what a command prints that the page shows."""

VALUES = {
    "bus": {"interface": "udp_multicast", "channel": "239.74.163.9", "command_timeout_s": 1.0},
    "load": {"reference_max": 150.0, "model": {"gain": 0.4}},
    "interlocks": {"output_max": 180.0, "stale_s": 0.5},
}
"""What part 2 of the page sets, for a simulated drive on a shared laptop."""

TRUE_MODEL = {"gain": 0.35, "tau_motor_s": 0.9, "tau_filter_s": 0.3}


def commands() -> list[str]:
    """The recorded commands of the page, in their order."""
    return BLOCK.findall(PAGE.read_text(encoding="utf-8"))


def walk(folder: Path, *options: str) -> dict[str, str]:
    """Carry out the commands of the page in an empty folder; what each printed.

    Args:
        folder: Where the files go.
        options: Of `commission`, besides those of the page.
    """
    shutil.copy(Path(__file__).with_name("pump.dbc"), folder)
    port = free_port(socket.SOCK_STREAM)
    environment = os.environ | {"ADAPTDRIVE_BROKER": f"127.0.0.1:{port}"}

    def run(command: str) -> str:
        words = [*command.split(), *(options if command.startswith("commission") else ())]
        return _run(folder, environment, words)

    describing, operating = _halves(commands())
    recorded = {describing[0]: run(describing[0])}
    _edit(folder / "pump.toml", {**VALUES, "mqtt": {"port": port}}, folder / "pump.toml")
    _edit(folder / "pump.toml", {"load": {"model": TRUE_MODEL}}, folder / "practice.toml")
    recorded |= {command: run(command) for command in describing[1:]}
    with _Desk(folder, environment):
        recorded |= {command: run(command) for command in operating}
    return recorded


def _halves(everything: list[str]) -> tuple[list[str], list[str]]:
    """The commands before the daemon runs, and the others."""
    describing = [one for one in everything if one.split()[0] in {"init", "check"}]
    return describing, [one for one in everything if one not in describing]


def _run(folder: Path, environment: dict[str, str], words: list[str]) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "adaptdrive.cli", *words],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        stdin=subprocess.DEVNULL,
        text=True,
        timeout=LONGEST_S,
        check=False,
    )
    assert done.returncode == 0, f"{words}: {done.stdout}"
    return done.stdout.replace(f"{folder}/", "")


def _edit(source: Path, changes: dict[str, Any], target: Path) -> None:
    document = tomlkit.parse(source.read_text(encoding="utf-8"))
    _merge(document, changes)
    adapted = tomlkit.dumps(document).replace("# example: ", "# ")
    target.write_text(adapted, encoding="utf-8")


def _merge(into: Any, changes: dict[str, Any]) -> None:
    for key, value in changes.items():
        if isinstance(value, dict):
            _merge(into[key], value)
        else:
            into[key] = value


class _Desk:
    """`adaptdrive start` in its terminal, from the first reading of the drive on."""

    def __init__(self, folder: Path, environment: dict[str, str]) -> None:
        self._screen = Screen()
        words = ["start", "pump.toml", "--simulate", "practice.toml"]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "adaptdrive.cli", *words],
            cwd=folder,
            env=environment | {"TERM": "xterm", "LINES": "40", "COLUMNS": "120"},
            stdin=self._screen.inner,
            stdout=self._screen.inner,
            stderr=self._screen.inner,
        )

    def __enter__(self) -> None:
        until(lambda: " standby " in self._screen.read(), "the drive is heard", 120.0)

    def __exit__(self, *_: object) -> None:
        self._screen.press("q")
        deadline_s = time.monotonic() + 60.0
        while self._process.poll() is None and time.monotonic() < deadline_s:
            self._screen.read()  # a full terminal would hold its end up
            time.sleep(0.1)
        self._process.kill()
        self._process.wait()
        self._screen.close()


def page_with(recorded: dict[str, str], page: str) -> str:
    """The page with what the commands printed."""

    def block(found: re.Match[str]) -> str:
        lines = [line.rstrip() for line in recorded[found[1]].strip().splitlines()]
        if shown := SHOWN.get(found[1].split()[0]):
            lines = [*lines[: shown[0]], "…", *lines[-shown[1] :]]
        return "\n".join(["```console", f"$ adaptdrive {found[1]}", *lines, "```"])

    return BLOCK.sub(block, page)


def main() -> None:
    """Record the way, and write page and figure."""
    with TemporaryDirectory() as name:
        folder = Path(name).resolve()
        began_s = time.monotonic()
        recorded = walk(folder)
        sys.stdout.write(f"from init to adaptive: {time.monotonic() - began_s:.0f} s\n")
        shutil.copy(folder / "commission.png", FIGURE)
    PAGE.write_text(page_with(recorded, PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
