"""The simulated drive as a process of its own, on a real bus and a real broker."""

import asyncio
import itertools
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import aiomqtt
import can
import cantools
import crccheck.crc
import pytest

from adaptdrive.config.bus import CanBus
from adaptdrive.hardware.link.bus import open_bus
from tests.support import (
    Broker,
    MosquittoLauncher,
    Process,
    Spawn,
    logged_events,
    prefer,
    stop_process,
)

DATABASE = Path(__file__).parents[2] / "deploy" / "examples" / "adaptdrive.dbc"
GROUP = "239.74.163.2"
PATIENCE_s = 120.0
COMMAND, STATUS, LOAD = 0x080, 0x100, 0x101


def configuration(port: int) -> str:
    return f"""
[drive]
name = "bench"
[bus]
type = "can"
interface = "udp_multicast"
channel = "{GROUP}"
udp_port = {port}
database = "{DATABASE}"
clock = "DriveLoad"
integrity.DriveStatus = {{ counter = "StatusAlive", checksum = "StatusCrc" }}
integrity.DriveLoad = {{ counter = "LoadAlive", checksum = "LoadCrc" }}
integrity.DriveCommand = {{ counter = "CommandAlive", checksum = "CommandCrc" }}
[signals]
boost_voltage_V = "DriveStatus.BoostVoltage"
line_voltage_V = "DriveStatus.LineVoltage"
load_power_W = "DriveStatus.LoadPower"
output = "DriveLoad.Tachometer"
counter = "DriveLoad.HalfCycle"
fault = "DriveStatus.Fault"
bridge = "DriveStatus.BridgeOn"
command.current_scale_S = "DriveCommand.CurrentScale"
command.bridge = "DriveCommand.BridgeEnable"
[load]
type = "motor"
reference_max = 4.0
model = {{ gain = 0.011, tau_motor_s = 11.7, tau_filter_s = 10.0 }}
[interlocks]
output_max = 5.0
"""


class Host:
    """A host computer made from python-can, cantools and crccheck."""

    def __init__(self, port: int) -> None:
        bus = CanBus(
            type="can",
            interface="udp_multicast",
            channel=GROUP,
            udp_port=port,
            database=DATABASE,
            clock="DriveLoad",
        )
        self.bus = open_bus(bus)
        database = cantools.database.load_file(DATABASE)
        assert isinstance(database, cantools.database.Database)
        self.database = database
        self.alive = 0

    def hear(self, frame_id: int) -> dict[str, Any]:
        """The next message with an id."""
        return next(values for found, values in self.frames() if found == frame_id)

    def frames(self) -> Iterator[tuple[int, dict[str, Any]]]:
        """Every message that the drive sends from now on, its checksum verified."""
        while self.bus.recv(0) is not None:
            pass
        while True:
            frame = self.bus.recv(PATIENCE_s)
            assert frame is not None, "the drive is silent"
            if frame.arbitration_id in {STATUS, LOAD}:
                crc = crccheck.crc.Crc8SaeJ1850.calc(frame.data[:7])
                assert frame.data[7] == crc
                decoded = self.database.decode_message(
                    frame.arbitration_id, bytes(frame.data), decode_choices=False
                )
                assert isinstance(decoded, dict)
                yield frame.arbitration_id, decoded

    def command(self, scale_S: float, *, bridge: bool, damage: int = 0) -> None:
        """Send one command; `damage` is laid over its checksum."""
        values = {
            "CurrentScale": scale_S,
            "BoostReference": 300.0,
            "BridgeEnable": int(bridge),
            "CommandAlive": self.alive,
            "CommandCrc": 0,
        }
        self.alive = (self.alive + 1) % 16
        data = bytearray(self.database.encode_message("DriveCommand", values))
        data[7] = crccheck.crc.Crc8SaeJ1850.calc(data[:7]) ^ damage
        self.bus.send(can.Message(arbitration_id=COMMAND, is_extended_id=False, data=data))

    def command_until(self, condition: Callable[[dict[str, Any]], bool], **command: Any) -> None:
        """Answer every status with a command until a status meets a condition."""
        deadline = time.monotonic() + PATIENCE_s
        for frame_id, values in self.frames():
            if frame_id == STATUS and condition(values):
                return
            if frame_id == LOAD:
                self.command(0.03, **command)
            assert time.monotonic() < deadline


class Node:
    """A running node and its log."""

    def __init__(self, process: Process, log: Path) -> None:
        self.process = process
        self._log = log

    def text(self) -> str:
        return self._log.read_text()

    def events(self, name: str) -> list[dict[str, Any]]:
        return logged_events(self._log, name)

    def wait_for(self, name: str) -> dict[str, Any]:
        """The first event of a name."""
        deadline = time.monotonic() + PATIENCE_s
        while not self.events(name):
            assert self.process.poll() is None, self.text()
            assert time.monotonic() < deadline, self.text()
            time.sleep(0.02)
        return self.events(name)[0]


StartNode = Callable[..., Node]


@pytest.fixture
def config(tmp_path: Path, free_udp_port: int) -> Path:
    path = tmp_path / "motor.toml"
    path.write_text(configuration(free_udp_port))
    return path


@pytest.fixture
def host(free_udp_port: int) -> Iterator[Host]:
    host = Host(free_udp_port)
    yield host
    host.bus.shutdown()


@pytest.fixture
def node(config: Path, spawn: Spawn, tmp_path: Path) -> StartNode:
    def start(*options: str) -> Node:
        process = spawn(sys.executable, "-m", "adaptdrive_sim", "device", config, *options)
        return Node(process, tmp_path / "process-0.log")

    return start


def simulator(*words: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "adaptdrive_sim", *words]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=240.0)


def test_each_half_cycle_is_a_status_and_then_a_load_message(host: Host, node: StartNode) -> None:
    node("--initial-voltage", "300")
    host.hear(LOAD)
    heard = [frame for frame, _ in zip(host.frames(), range(240), strict=False)]
    ids = [frame_id for frame_id, _ in heard]
    assert ids[ids.index(STATUS) :][:200] == [STATUS, LOAD] * 100
    loads = [values for frame_id, values in heard if frame_id == LOAD]
    alive = [values["LoadAlive"] for values in loads]
    assert all((b - a) % 16 == 1 for a, b in itertools.pairwise(alive))
    halves = [values["HalfCycle"] for values in loads]
    assert 118 <= halves[-1] - halves[0] <= 240


def test_half_cycles_pass_at_the_pace_of_the_line(host: Host, node: StartNode) -> None:
    """Half the rate and twice the rate fail, whatever a busy machine adds."""
    prefer(node().process)
    first, start_s = host.hear(LOAD)["HalfCycle"], time.monotonic()
    time.sleep(2.0)
    last, end_s = host.hear(LOAD)["HalfCycle"], time.monotonic()
    assert (last - first) / (end_s - start_s) == pytest.approx(120.0, rel=0.4)


def test_without_commands_the_drive_is_safe_at_the_peak_of_the_line(
    host: Host, node: StartNode
) -> None:
    node()
    status, load = host.hear(STATUS), host.hear(LOAD)
    assert (status["BridgeOn"], status["Fault"]) == (0, 0)
    assert status["BoostVoltage"] == pytest.approx(169.7, abs=0.1)
    assert status["LineVoltage"] == 120.0
    assert (load["Tachometer"], load["LoadCurrent"]) == (0.0, 0.0)


def test_it_obeys_commands_and_is_safe_100_ms_after_the_last(host: Host, node: StartNode) -> None:
    running = node("--initial-voltage", "300")
    host.command_until(lambda status: status["LoadPower"] > 400.0, bridge=True)
    assert host.hear(LOAD)["LoadCurrent"] > 4.0
    safe = running.wait_for("safe")
    assert safe["after_ms"] >= 100.0
    assert safe["reason"] == "command timeout"
    assert (safe["current_scale_S"], safe["bridge"], safe["load_current_A"]) == (0.0, False, 0.0)
    assert safe["monotonic_s"] == pytest.approx(time.monotonic(), abs=PATIENCE_s)
    assert (host.hear(STATUS)["BridgeOn"], host.hear(LOAD)["LoadCurrent"]) == (0, 0.0)
    host.command_until(lambda status: status["BridgeOn"] == 1, bridge=True)


def test_a_drive_that_holds_its_own_voltage_obeys_v_c_and_not_the_current_scale(
    host: Host, config: Path, node: StartNode
) -> None:
    given = 'command.bridge = "DriveCommand.BridgeEnable"'
    more = 'command.boost_reference_V = "DriveCommand.BoostReference"'
    text = config.read_text().replace(given, f"{given}\n{more}")
    config.write_text(f'{text}[voltage_loop]\nwhere = "drive"\n')
    running = node("--initial-voltage", "250")
    host.command_until(lambda status: status["BoostVoltage"] > 299.0, bridge=True)
    heard: list[float] = []

    def heard_enough(status: dict[str, Any]) -> bool:
        heard.append(status["BoostVoltage"])
        return len(heard) > 240

    host.command_until(heard_enough, bridge=True)
    assert heard[-120:] == pytest.approx([300.0] * 120, abs=3.0)
    assert running.wait_for("safe")["reason"] == "command timeout"


def test_a_damaged_command_is_ignored(host: Host, node: StartNode) -> None:
    running = node("--initial-voltage", "300")
    for _ in range(30):
        host.hear(LOAD)
        host.command(0.03, bridge=True, damage=0x01)
    assert host.hear(STATUS)["BridgeOn"] == 0
    assert running.wait_for("command refused")["reason"] == "wrong_checksum"
    assert running.events("commanded") == []


def test_a_repeated_command_does_not_keep_it_alive(host: Host, node: StartNode) -> None:
    running = node("--initial-voltage", "300")
    host.command_until(lambda status: status["BridgeOn"] == 1, bridge=True)
    repeated = (host.alive - 1) % 16
    deadline = time.monotonic() + PATIENCE_s
    while not running.events("safe"):
        host.hear(LOAD)
        host.alive = repeated
        host.command(0.03, bridge=True)
        assert time.monotonic() < deadline
    assert running.events("command refused")[0]["reason"] == "counter_stuck"


def test_it_says_which_bus_it_is_on_and_ends_cleanly(
    host: Host, node: StartNode, free_udp_port: int
) -> None:
    running = node()
    host.hear(LOAD)
    running.process.terminate()
    assert running.process.wait(PATIENCE_s) == 0
    bus = f"udp_multicast {GROUP}:{free_udp_port}"
    assert running.text().splitlines()[0] == f"simulated drive bench on {bus}"
    assert running.events("stopped")[0]["sent"] > 0
    assert "Traceback" not in running.text()


def test_the_noise_of_the_output_is_as_asked(host: Host, node: StartNode) -> None:
    node("--noise", "0.01", "--initial-voltage", "300")
    values = [host.hear(LOAD)["Tachometer"] for _ in range(40)]
    steps = [abs(b - a) for a, b in itertools.pairwise(values)]
    assert 0.003 < sum(steps) / len(steps) < 0.03


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (("--disks", "0"), "disks = 0 must lie in 1…10"),
        (("--noise", "-1"), "NoiseParameters.sigma = -1.0 must lie in"),
        (("--initial-voltage", "100"), "boost_voltage_V = 100.0 must be at least"),
        (("--broker", "a b"), "broker 'a b' is not HOST:PORT"),
    ],
)
def test_a_wrong_option_is_one_clear_line(
    config: Path, options: tuple[str, ...], complaint: str
) -> None:
    result = simulator("device", config, *options)
    assert result.returncode == 1
    assert complaint in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_a_missing_configuration_is_one_clear_line(tmp_path: Path) -> None:
    result = simulator("device", tmp_path / "none.toml")
    assert result.returncode == 1
    assert "none.toml" in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_signals_that_the_database_does_not_have_are_named(config: Path) -> None:
    config.write_text(config.read_text().replace("DriveLoad.Tachometer", "DriveLoad.Tacho"))
    result = simulator("device", config)
    assert result.returncode == 1
    assert "signals.output: message 'DriveLoad' has no signal 'Tacho'" in result.stderr


async def test_disturbances_over_a_real_broker(node: StartNode, mosquitto: Broker) -> None:
    address = f"{mosquitto.host}:{mosquitto.port}"
    running = node("--broker", address)
    async with asyncio.timeout(60.0), aiomqtt.Client(mosquitto.host, mosquitto.port) as client:
        await client.subscribe("adaptdrive-sim/bench/#", qos=1)
        assert (await truth_where(client, "disks", 1))["tau_motor_s"] == pytest.approx(11.7)
        added = await asyncio.to_thread(
            simulator, "disturb", "bench", "add-disk", "--broker", address
        )
        assert (added.returncode, added.stderr) == (0, "")
        assert (await truth_where(client, "disks", 2))["tau_motor_s"] == pytest.approx(23.4)
        request = json.dumps({"id": "mine", "sag": 2.0, "duration_s": 1.0})
        await client.publish("adaptdrive-sim/bench/disturb", request, qos=1)
        reply = await message_on(client, "adaptdrive-sim/bench/reply")
        assert reply["id"] == "mine"
        assert not reply["accepted"]
        assert "sag = 2.0 must lie in 0…1" in reply["reason"]
        running.process.terminate()
        assert running.process.wait(PATIENCE_s) == 0
        await truth_removed(client)


async def message_on(client: aiomqtt.Client, topic: str) -> dict[str, Any]:
    async for message in client.messages:
        if message.topic.value == topic and message.payload:
            found: dict[str, Any] = json.loads(message.payload)
            return found
    raise AssertionError("the broker is gone")


async def truth_where(client: aiomqtt.Client, name: str, value: float) -> dict[str, Any]:
    while True:
        truth = await message_on(client, "adaptdrive-sim/bench/truth")
        if truth[name] == value:
            return truth


async def truth_removed(client: aiomqtt.Client) -> None:
    async for message in client.messages:
        if message.topic.value == "adaptdrive-sim/bench/truth" and not message.payload:
            return


def test_a_refused_disturbance_has_its_own_status(node: StartNode, mosquitto: Broker) -> None:
    address = f"{mosquitto.host}:{mosquitto.port}"
    node("--broker", address).wait_for("broker found")
    result = simulator("disturb", "bench", "remove-disk", "--broker", address)
    assert result.returncode == 1
    assert "refused: disks = 0 must lie in 1…10" in result.stderr


def test_nobody_to_disturb_has_its_own_status(mosquitto: Broker) -> None:
    address = f"{mosquitto.host}:{mosquitto.port}"
    result = simulator("disturb", "nobody", "torque", "0.5", "--broker", address)
    assert result.returncode == 3
    assert result.stderr == f"adaptdrive-sim: no answer from nobody at {address}\n"


def test_a_broker_that_is_not_there_is_named_with_its_problem(free_tcp_port: int) -> None:
    address = f"127.0.0.1:{free_tcp_port}"
    result = simulator("disturb", "bench", "torque", "0.5", "--broker", address)
    assert result.returncode == 3
    assert result.stderr.startswith(f"adaptdrive-sim: broker {address}: ")
    assert "refused" in result.stderr
    assert result.stderr.count("\n") == 1


def test_the_node_outlives_its_broker_and_finds_it_again(
    host: Host, node: StartNode, mosquitto_launcher: MosquittoLauncher, free_tcp_port: int
) -> None:
    broker = mosquitto_launcher.start(free_tcp_port)
    try:
        running = node("--broker", f"127.0.0.1:{free_tcp_port}")
        running.wait_for("broker found")
    finally:
        stop_process(broker)
    running.wait_for("broker away")
    before = host.hear(LOAD)["HalfCycle"]
    broker = mosquitto_launcher.start(free_tcp_port)
    try:
        deadline = time.monotonic() + PATIENCE_s
        while len(running.events("broker found")) < 2:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        assert host.hear(LOAD)["HalfCycle"] > before
    finally:
        stop_process(broker)
    assert running.events("stalled") == []
