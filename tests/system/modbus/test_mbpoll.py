"""The simulated drive in its own process, as mbpoll sees it."""

from __future__ import annotations

import re
import shutil
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support import Spawn

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
PATIENCE_s = 120.0
MBPOLL = shutil.which("mbpoll")
_LINE = re.compile(r"^\[(\d+)\]:\s+(-?\d+)", re.MULTILINE)
_BIG = {"boost": 16, "line": 17, "speed": 19, "status": 21, "beat": 23}
_SMALL = {"boost": 0, "line": 1, "speed": 4, "status": 6, "beat": 8}


@dataclass(frozen=True, slots=True)
class Site:
    """The example of a kind of link, and how mbpoll reaches its drive."""

    kind: str
    config: Path
    link: tuple[str, ...]
    log: Path

    def mbpoll(self, *words: str, values: Sequence[int] = ()) -> dict[int, int]:
        """Run mbpoll once; the registers that it shows, by zero-based address."""
        assert MBPOLL is not None
        target = "127.0.0.1" if self.kind == "tcp" else str(self.config.parent / "motor.tty")
        done = subprocess.run(
            [MBPOLL, *self.link, "-a", "1", "-0", "-1", *words, target, *map(str, values)],
            check=False,
            capture_output=True,
            text=True,
            timeout=PATIENCE_s,
        )
        assert done.returncode == 0, done.stderr
        assert "failed" not in done.stderr, done.stderr
        return {int(address): int(word) for address, word in _LINE.findall(done.stdout)}

    def command(self, *values: int) -> None:
        """Write the registers of the command: voltage, bridge and heartbeat."""
        self.mbpoll("-t", "4", "-r", "0", values=values)

    def measured(self) -> dict[str, float]:
        """What the documented map says that mbpoll's registers mean."""
        words = (
            ("-t", "4", "-r", "16", "-c", "8")
            if self.kind == "tcp"
            else ("-t", "3", "-r", "0", "-c", "9")
        )
        read, places = self.mbpoll(*words), _BIG if self.kind == "tcp" else _SMALL
        found = {name: float(read[at] & 0xFFFF) for name, at in places.items()}
        first, other = (read[places["speed"] + at] & 0xFFFF for at in (0, 1))
        if self.kind == "tcp":
            speed = struct.unpack(">i", struct.pack(">HH", first, other))[0] * 1e-6
        else:
            speed = struct.unpack(">f", struct.pack(">HH", other, first))[0]
        scaled = {"boost": 0.01 * found["boost"], "line": 0.1 * found["line"]}
        return {**found, **scaled, "speed": float(speed)}

    def stops(self, reason: str) -> None:
        """Wait until the drive has its bridge off by itself."""
        wait_for(lambda: self.measured()["status"] == 0)
        assert f'"reason": "{reason}"' in self.log.read_text()


@pytest.fixture(params=[pytest.param("tcp", marks=pytest.mark.proof), "rtu"])
def site(request: pytest.FixtureRequest, tmp_path: Path, free_tcp_port: int, spawn: Spawn) -> Site:
    """A drive that serves."""
    if MBPOLL is None:
        pytest.skip("mbpoll is not installed")
    kind, config = str(request.param), tmp_path / "motor.toml"
    text = (EXAMPLES / f"motor-modbus-{kind}.toml").read_text()
    config.write_text(text.replace("port = 5020", f"port = {free_tcp_port}"))
    tcp, rtu = ("-p", str(free_tcp_port)), ("-b", "19200", "-P", "none", "-s", "2")
    log = tmp_path / "process-0.log"
    one = Site(kind, config, ("-m", kind, *(tcp if kind == "tcp" else rtu)), log)
    spawn(sys.executable, "-m", "adaptdrive_sim", "device", config, "--initial-voltage", "250")
    wait_for(lambda: re.search("simulated drive .* on modbus-", log.read_text()) is not None)
    return one


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_s
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_mbpoll_sees_the_documented_map_and_commands_the_drive(site: Site) -> None:
    """It holds the voltage itself, and stops where nobody commands it with a new heartbeat."""
    first, second = site.measured(), site.measured()
    assert first["boost"] == pytest.approx(250.0, abs=0.1)
    assert first["line"] == pytest.approx(120.0, abs=0.1)
    assert first["speed"] == pytest.approx(0.011 * 250.0, rel=0.05)
    assert first["status"] == 0
    assert second["beat"] > first["beat"]
    with pytest.raises(AssertionError, match="Illegal data value"):
        site.command(65000, 1, 1)
    beats = iter(range(2, 1000))

    def runs() -> bool:
        site.command(25000, 1, next(beats))
        return site.measured()["status"] == 1

    wait_for(runs)
    assert site.measured()["boost"] > 240.0
    kept = site.mbpoll("-t", "4", "-r", "0", "-c", "3")
    assert (kept[0], kept[1]) == (25000, 1)
    site.stops("command timeout")
    for _ in range(6):
        site.command(25000, 1, 7)
    site.stops("counter_stuck")
