"""The simulated devices of each kind of bus, and disturbances of them over MQTT.

The drive's node never waits for any of this: when the broker is away the node runs on, and a new
client is tried at growing intervals.
"""

import asyncio
import contextlib
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

import aiomqtt
import msgspec

from adaptdrive.config import Configuration
from adaptdrive.config.services import Mqtt
from adaptdrive.devices.can.kind import map_sensors
from adaptdrive.mqtt.contract import DeviceReply, simulator_topic
from adaptdrive.mqtt.steady import SteadyClient
from adaptdrive_sim.devices import can, canopen, disturbances, frames, modbus, scpi
from adaptdrive_sim.devices.drive import Report, SimulatedDrive

# The simulated devices of each kind of bus.


class SensorNode(Protocol):
    """Sensors on a bus."""

    async def run(self, opened: Callable[[str], None]) -> None:
        """Open the bus, name it to `opened`, and serve it until cancelled."""


class DriveNode(SensorNode, Protocol):
    """A drive on a bus."""

    counts: Counter[str]


@dataclass(frozen=True, slots=True)
class DeviceKind:
    """The simulated devices of one kind of bus.

    Attributes:
        drive: Puts a drive on the bus of a configuration.
        overrides: Key of `[bus]` that each option of the command line replaces.
        sensors: Puts sensors on a bus, given its section and its place; None for no such kind.
        times_commands: Whether the drive shuts down when commands stop; otherwise a heartbeat.
    """

    drive: Callable[[SimulatedDrive, Configuration, Report, Path], DriveNode]
    overrides: Mapping[str, str]
    sensors: Callable[[SimulatedDrive, Any, str, Path], SensorNode] | None = None
    times_commands: bool = True


def _can_drive(
    drive: SimulatedDrive, configuration: Configuration, report: Report, source: Path
) -> DriveNode:
    bus: Any = configuration.bus
    return can.CanDrive(drive, bus, frames.load_messages(bus, configuration, source), report)


def _can_sensors(drive: SimulatedDrive, bus: Any, place: str, source: Path) -> SensorNode:  # noqa: ANN401
    return can.CanSensors(drive, bus, map_sensors(bus, place, source))


def _modbus_drive(
    drive: SimulatedDrive, configuration: Configuration, report: Report, _: Path
) -> DriveNode:
    bus: Any = configuration.bus
    return modbus.ModbusDrive(drive, bus, configuration.signals, report)


def _scpi_drive(
    drive: SimulatedDrive, configuration: Configuration, report: Report, _: Path
) -> DriveNode:
    bus: Any = configuration.bus
    return scpi.ScpiDrive(drive, bus, configuration.signals, report)


def _modbus_sensors(drive: SimulatedDrive, bus: Any, _: str, __: Path) -> SensorNode:  # noqa: ANN401
    return modbus.ModbusSensors(drive, bus)


_CAN_KEYS = {"interface": "interface", "channel": "channel", "port": "udp_port"}

KINDS = {
    "can": DeviceKind(_can_drive, _CAN_KEYS, _can_sensors),
    "canopen": DeviceKind(canopen.CanOpenDrive, _CAN_KEYS, times_commands=False),
    "modbus-tcp": DeviceKind(_modbus_drive, {"channel": "host", "port": "port"}, _modbus_sensors),
    "modbus-rtu": DeviceKind(_modbus_drive, {"channel": "device"}, _modbus_sensors),
    "scpi": DeviceKind(_scpi_drive, {"channel": "host", "port": "port"}),
}


# Disturbances over MQTT, and the true parameters for comparison with estimates.

TRUTH_PERIOD_s = 1.0
RETRY_FIRST_s = 0.5
RETRY_LAST_s = 10.0
FAREWELL_s = 1.0


class Remote:
    """Serves one simulated drive on one broker."""

    def __init__(self, broker: Mqtt, name: str, drive: SimulatedDrive, report: Report) -> None:
        self._broker = broker
        self._name = name
        self._drive = drive
        self._report = report
        self._retry_s = RETRY_FIRST_s

    async def run(self) -> None:
        """Serve until cancelled; reconnect whenever the broker is lost."""
        while True:
            try:
                await self._serve()
            except* aiomqtt.MqttError as problems:
                reason = str(problems.exceptions[0])
                self._report("broker away", reason=reason, retry_s=self._retry_s)
            await asyncio.sleep(self._retry_s)
            self._retry_s = min(2.0 * self._retry_s, RETRY_LAST_s)

    async def _serve(self) -> None:
        """Serve one connection until it is lost."""
        truth = simulator_topic(self._name, "truth")
        will = aiomqtt.Will(truth, payload=b"", qos=1, retain=True)
        address = self._broker
        async with SteadyClient(address.host, address.port, will=will) as client:
            self._report("broker found", broker=f"{address.host}:{address.port}")
            self._retry_s = RETRY_FIRST_s
            try:
                async with asyncio.TaskGroup() as tasks:
                    tasks.create_task(self._publish_truth(client, truth))
                    tasks.create_task(self._answer(client))
            finally:
                with contextlib.suppress(aiomqtt.MqttError, TimeoutError):
                    async with asyncio.timeout(FAREWELL_s):
                        await client.publish(truth, b"", qos=1, retain=True)

    async def _publish_truth(self, client: SteadyClient, truth: str) -> None:
        while True:
            payload = msgspec.json.encode(self.state())
            await client.publish(truth, payload, qos=0, retain=True)
            await asyncio.sleep(TRUTH_PERIOD_s)

    async def _answer(self, client: SteadyClient) -> None:
        await client.subscribe(simulator_topic(self._name, "disturb"), qos=1)
        async for message in client.messages:
            reply = self.carry_out(message.payload, retained=bool(message.retain))
            encoded = msgspec.json.encode(reply)
            await client.publish(simulator_topic(self._name, "reply"), encoded, qos=1)

    def carry_out(self, payload: bytes, *, retained: bool) -> DeviceReply:
        """Carry out one request, or return the reason of a refusal."""
        if retained:
            return disturbances.refused(payload, "a retained request is old and is not carried out")
        reply = disturbances.answer(payload, self._drive)
        if reply.accepted:
            self._report("disturbed", **msgspec.json.decode(payload))
        return reply

    def state(self) -> Mapping[str, Any]:
        """Return the truth, and the disturbances that the device offers."""
        return {**self.truth(), "features": disturbances.features_of(self._drive.world.load)}

    def truth(self) -> Mapping[str, float | str]:
        """Return the true parameters for comparison with estimates, and the surroundings."""
        world = self._drive.world
        return {
            "time": datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z"),
            **world.truth(),
            "fault": self._drive.fault,
        }
