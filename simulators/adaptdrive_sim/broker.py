"""The simulator's own topics on an MQTT broker.

    adaptdrive-sim/DRIVE/disturb   requests, see `adaptdrive_sim.disturbances`; never retained
    adaptdrive-sim/DRIVE/reply     the answer to each: id, accepted, reason
    adaptdrive-sim/DRIVE/truth     retained, once a second: what an estimator is to find, and
                                   the disturbances that the device offers

The truth is removed when the simulated drive goes away, by its last will if need be.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from adaptdrive.config.services import Mqtt, check_host
from adaptdrive.errors import RefusedError


@dataclass(frozen=True, slots=True)
class BrokerAddress:
    """Address of a broker."""

    host: str
    port: int

    @property
    def mqtt(self) -> Mqtt:
        """The broker, in the words of the configuration."""
        return Mqtt(host=self.host, port=self.port)


def parse_address(text: str) -> BrokerAddress:
    """Read `HOST:PORT`, where an IPv6 address stands in brackets; the port may be left out.

    Raises:
        RefusedError: It is no such thing.
    """
    match = re.fullmatch(r"(\[[^\]]+\]|[^:\s]+)(?::(\d{1,5}))?", text)
    if match is None:
        raise RefusedError(f"broker {text!r} is not HOST:PORT")
    port = int(match[2] or 1883)
    if not 1 <= port <= 65535:
        raise RefusedError(f"broker {text!r}: port {port} must lie in 1…65535")
    try:
        return BrokerAddress(check_host(match[1].strip("[]")), port)
    except ValueError as problem:
        raise RefusedError(f"broker {text!r}: {problem}") from problem
