"""The simulated drive in its own process: as mbpoll sees it, and as the daemon drives it."""

from __future__ import annotations

import json
import re
import shutil
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import paho.mqtt.client as mqtt
import pytest
from paho.mqtt.enums import CallbackAPIVersion

from tests.support import Broker, Process, Spawn, prefer

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
PATIENCE_s = 120.0
STALE_s = 2.0
"""Other tests may hold the processors longer than the examples' limit allows a drive."""
COMMAND_TIMEOUT_s = "3.0"
HELD_POLLS = 60
"""At 100 ms each."""
_MAIN = "import sys; from adaptdrive.cli import main; sys.exit(main())"
MBPOLL = shutil.which("mbpoll")
needs_mbpoll = pytest.mark.skipif(MBPOLL is None, reason="mbpoll is not installed")
_LINE = re.compile(r"^\[(\d+)\]:\s+(-?\d+)", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Site:
    """A configuration of its own for a test.

    Attributes:
        kind: `tcp` or `rtu`.
        config: The configuration's file.
        link: How mbpoll reaches the drive.
        log: Output of the drive's process.
    """

    kind: str
    config: Path
    link: tuple[str, ...]
    target: str
    log: Path

    def mbpoll(self, *words: str, values: Sequence[int] = ()) -> dict[int, int]:
        """Run mbpoll once; the registers that it shows, by zero-based address."""
        assert MBPOLL is not None
        command = [MBPOLL, *self.link, "-a", "1", "-0", "-1", *words, self.target]
        done = subprocess.run(
            [*command, *(str(value) for value in values)],
            check=False,
            capture_output=True,
            text=True,
            timeout=PATIENCE_s,
        )
        assert done.returncode == 0, done.stderr
        assert "failed" not in done.stderr, done.stderr
        return {int(address): int(word) for address, word in _LINE.findall(done.stdout)}


@pytest.fixture(params=["tcp", "rtu"])
def site(request: pytest.FixtureRequest, tmp_path: Path, free_tcp_port: int) -> Site:
    """The example of each kind, on a link of its own."""
    kind = str(request.param)
    text = (EXAMPLES / f"motor-modbus-{kind}.toml").read_text()
    config = tmp_path / "motor.toml"
    text = re.sub(r"^stale_s = [0-9.]+", f"stale_s = {STALE_s}", text, flags=re.MULTILINE)
    config.write_text(text.replace("port = 5020", f"port = {free_tcp_port}"))
    log = tmp_path / "process-0.log"
    if kind == "tcp":
        return Site(kind, config, ("-m", "tcp", "-p", str(free_tcp_port)), "127.0.0.1", log)
    link = ("-m", "rtu", "-b", "19200", "-P", "none", "-s", "2")
    return Site(kind, config, link, str(tmp_path / "motor.tty"), log)


def start_drive(site: Site, spawn: Spawn, *options: str) -> Process:
    """Start the simulated drive and wait until it serves."""
    process = spawn(sys.executable, "-m", "adaptdrive_sim", "device", site.config, *options)
    wait_for(lambda: re.search("simulated drive .* on modbus-", site.log.read_text()) is not None)
    return process


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_s
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def value(site: Site, name: str, words: dict[int, int]) -> float:
    """What the documented map says that mbpoll's registers mean."""
    big = {"boost": 16, "line": 17, "speed": 19, "status": 21, "beat": 23}
    small = {"boost": 0, "line": 1, "speed": 4, "status": 6, "beat": 8}
    address = (big if site.kind == "tcp" else small)[name]
    word = words[address] & 0xFFFF
    match name:
        case "boost":
            return word * 0.01
        case "line":
            return word * 0.1
        case "speed":
            other = words[address + 1] & 0xFFFF
            if site.kind == "tcp":
                return float(struct.unpack(">i", struct.pack(">HH", word, other))[0]) * 1e-6
            return float(struct.unpack(">f", struct.pack(">HH", other, word))[0])
    return float(word)


def measured(site: Site) -> dict[int, int]:
    if site.kind == "tcp":
        return site.mbpoll("-t", "4", "-r", "16", "-c", "8")
    return site.mbpoll("-t", "3", "-r", "0", "-c", "9")


@needs_mbpoll
def test_mbpoll_sees_the_documented_map(site: Site, spawn: Spawn) -> None:
    start_drive(site, spawn, "--initial-voltage", "300")
    first, second = measured(site), measured(site)
    assert value(site, "boost", first) == pytest.approx(300.0, abs=0.1)
    assert value(site, "line", first) == pytest.approx(120.0, abs=0.1)
    assert value(site, "speed", first) == pytest.approx(0.011 * 300.0, rel=0.05)
    assert value(site, "status", first) == 0
    assert value(site, "beat", second) > value(site, "beat", first)


@needs_mbpoll
def test_mbpoll_commands_the_drive_which_holds_its_own_voltage(site: Site, spawn: Spawn) -> None:
    start_drive(site, spawn)
    reached = 0.0
    for beat in range(1, 40):
        site.mbpoll("-t", "4", "-r", "0", values=(25000, 1, beat))
        words = measured(site)
        reached = value(site, "boost", words)
        if reached > 240.0 and value(site, "status", words) == 1:
            break
    assert reached > 240.0
    kept = site.mbpoll("-t", "4", "-r", "0", "-c", "3")
    assert (kept[0], kept[1]) == (25000, 1)
    wait_for(lambda: value(site, "status", measured(site)) == 0)  # nobody commands it any more
    assert '"reason": "command timeout"' in site.log.read_text()


@needs_mbpoll
def test_a_command_whose_heartbeat_stands_still_is_not_obeyed(site: Site, spawn: Spawn) -> None:
    start_drive(site, spawn)
    for _ in range(6):
        site.mbpoll("-t", "4", "-r", "0", values=(25000, 1, 7))
    wait_for(lambda: value(site, "status", measured(site)) == 0)
    assert '"reason": "counter_stuck"' in site.log.read_text()


@needs_mbpoll
def test_a_value_out_of_range_is_answered_with_an_exception(site: Site, spawn: Spawn) -> None:
    start_drive(site, spawn)
    with pytest.raises(AssertionError, match="Illegal data value"):
        site.mbpoll("-t", "4", "-r", "0", values=(65000, 1, 1))


def test_a_rate_that_the_line_cannot_carry_is_found_by_check(tmp_path: Path) -> None:
    text = (EXAMPLES / "motor-modbus-rtu.toml").read_text()
    config = tmp_path / "slow.toml"
    config.write_text(text.replace("baud = 19200", "baud = 4800"))
    done = subprocess.run(
        [sys.executable, "-c", _MAIN, "check", config],
        check=False,
        capture_output=True,
        text=True,
        timeout=PATIENCE_s,
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert "bus.poll_ticks: asks for a cycle of 100.0 ms" in done.stderr
    assert "54 bytes of 11 bits at 4800 baud, 5 ms turnaround each" in done.stderr
    assert "bus.timeout_s" in done.stderr


class Operator:
    """An operator on the broker, made from paho alone."""

    def __init__(self, broker: Broker, drive: str) -> None:
        self.messages: dict[str, dict[str, object]] = {}
        self._drive = drive
        self._client = mqtt.Client(CallbackAPIVersion.VERSION2)
        self._client.on_message = self._hear
        self._client.connect(broker.host, broker.port)
        self._client.subscribe(f"adaptdrive/{drive}/#", qos=1)
        self._client.loop_start()
        self._number = 0

    def close(self) -> None:
        self._client.loop_stop()
        self._client.disconnect()

    def ask(self, verb: str, asked: object = None) -> None:
        """Ask for something that must be accepted."""
        reply = self.reply_to(verb, asked)
        assert reply["accepted"], reply

    def reply_to(self, verb: str, asked: object = None) -> dict[str, object]:
        """Ask for something and return the answer."""
        self._number += 1
        name = f"{self._drive}-{self._number}"
        payload = {"id": name} if asked is None else {"id": name, "value": asked}
        self._client.publish(
            f"adaptdrive/{self._drive}/command/{verb}", json.dumps(payload), qos=1
        ).wait_for_publish(PATIENCE_s)
        wait_for(lambda: self.messages.get("reply", {}).get("id") == name)
        return self.messages["reply"]

    def state(self) -> object:
        return self.messages.get("state", {}).get("state")

    def drive(self, name: str) -> float:
        found = self.messages.get("telemetry/drive", {}).get(name)
        return float(found) if isinstance(found, int | float) else float("nan")

    def wait_until_held(self, wanted: float, within: float) -> None:
        """Wait until the output has stayed close to a value for `HELD_POLLS`."""
        left = self.drive("ticks")

        def is_held() -> bool:
            nonlocal left
            ticks = self.drive("ticks")
            if not abs(self.drive("output") - wanted) < within:
                left = ticks
            return ticks >= left + HELD_POLLS

        wait_for(is_held)

    def _hear(self, _: object, __: object, message: mqtt.MQTTMessage) -> None:
        if message.payload.startswith(b"{"):
            name = message.topic.removeprefix(f"adaptdrive/{self._drive}/")
            self.messages[name] = json.loads(message.payload)


@pytest.fixture
def operator(site: Site, mosquitto: Broker, tmp_path: Path) -> Iterator[Operator]:
    """An operator of the site's drive, which has a name of its own on the broker."""
    name = f"modbus-{site.kind}-{tmp_path.name[-8:]}"
    name = re.sub(r"[^A-Za-z0-9_-]", "-", name)
    text = site.config.read_text().replace('name = "motor"', f'name = "{name}"')
    text = text.replace("port = 1883", f"port = {mosquitto.port}")
    text += "\n[recording]\nenabled = false\n"
    site.config.write_text(text)
    one = Operator(mosquitto, name)
    yield one
    one.close()


def start_running(
    site: Site, spawn: Spawn, operator: Operator, folder: Path
) -> tuple[Process, Process]:
    """Start the drive and its daemon, and enable it until it runs."""
    options = ("--initial-voltage", "273", "--command-timeout", COMMAND_TIMEOUT_s)
    drive = start_drive(site, spawn, *options)
    command = (sys.executable, "-c", _MAIN, "run", site.config)
    daemon = spawn("env", f"STATE_DIRECTORY={folder}", *command)
    wait_for(lambda: operator.drive("ticks") > 5)
    prefer(drive)
    prefer(daemon)
    operator.ask("enable")
    wait_for(lambda: operator.state() == "running")
    return drive, daemon


@pytest.mark.slow
def test_the_daemon_holds_the_motor_and_survives_its_drive(
    site: Site, spawn: Spawn, operator: Operator, tmp_path: Path
) -> None:
    _, daemon = start_running(site, spawn, operator, tmp_path / "state")
    operator.ask("setpoint", 3.0)
    wait_for(lambda: abs(operator.drive("boost_voltage_V") - 273.0) < 15.0)
    operator.wait_until_held(3.0, within=0.03)
    assert operator.state() == "running"
    daemon.terminate()
    assert daemon.wait(PATIENCE_s) == 0
    log = site.log.read_text()
    assert "Traceback" not in (tmp_path / "process-1.log").read_text()
    assert "Traceback" not in log


@pytest.mark.slow
def test_a_drive_that_dies_trips_the_daemon_and_its_return_lets_it_be_reset(
    site: Site, spawn: Spawn, operator: Operator, tmp_path: Path
) -> None:
    drive, _ = start_running(site, spawn, operator, tmp_path / "state")
    drive.terminate()
    assert drive.wait(PATIENCE_s) == 0
    wait_for(lambda: operator.state() == "tripped")
    assert "stale" in str(operator.messages["state"]["trip"])
    spawn(sys.executable, "-m", "adaptdrive_sim", "device", site.config)
    wait_for(lambda: bool(operator.reply_to("reset")["accepted"]))
    wait_for(lambda: operator.state() == "standby")
    operator.ask("enable")
    wait_for(lambda: operator.state() == "running")
