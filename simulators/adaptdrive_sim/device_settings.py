"""Command-line settings of a simulated drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cyclopts import Parameter

from adaptdrive.cli.options import Integer, read_address
from adaptdrive.config.services import Mqtt
from adaptdrive.util.errors import RefusedError

InterfaceChoice = Literal["socketcan", "udp_multicast"]


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class DeviceSettings:
    """Settings that `adaptdrive-sim device` adds to the configuration.

    Attributes:
        broker: HOST:PORT of an MQTT broker for disturbances; none when left out.
        noise_V: Standard deviation of each sample of the output, in the unit of the output.
        seed: Seed of the noise.
        disks: Disks on the shaft of a motor; one when left out.
        initial_voltage_V: Start at rest at this boost voltage instead of at standstill.
        command_timeout_s: Age of the last command, in seconds, at which it shuts down;
            `bus.command_timeout_s` when left out, or 0.1.
        boost_needs_bridge: The boost stage works only while the bridge's enable bit is on.
        line_drift_Hz: Amplitude of the line's frequency drift, in hertz.
        interface: Bus interface instead of the configured one.
        channel: Channel instead of the configured one.
        port: UDP port instead of the configured one.
    """

    broker: str | None = None
    noise_V: Annotated[float, Parameter(name="--noise")] = 0.0
    seed: Integer = 0
    disks: Integer | None = None
    initial_voltage_V: Annotated[float | None, Parameter(name="--initial-voltage")] = None
    command_timeout_s: Annotated[float | None, Parameter(name="--command-timeout")] = None
    boost_needs_bridge: bool = False
    line_drift_Hz: Annotated[float, Parameter(name="--line-drift")] = 0.1
    interface: InterfaceChoice | None = None
    channel: str | None = None
    port: Integer | None = None


def parse_address(text: str) -> Mqtt:
    """Read `HOST:PORT`, where an IPv6 address stands in brackets; the port may be left out.

    Raises:
        RefusedError: It is no such thing.
    """
    try:
        host, port = read_address(text)
    except ValueError as problem:
        raise RefusedError(f"broker {text!r} is not HOST:PORT") from problem
    return Mqtt(host=host, port=port)
