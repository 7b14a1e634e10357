"""The simulator's own topics on an MQTT broker.

    adaptdrive-sim/DRIVE/disturb   requests, see `adaptdrive_sim.disturbances`; never retained
    adaptdrive-sim/DRIVE/reply     the answer to each: id, accepted, reason
    adaptdrive-sim/DRIVE/truth     retained, once a second: what an estimator is to find, and
                                   the disturbances that the device offers

The truth is removed when the simulated drive goes away, by its last will if need be.
"""

from __future__ import annotations

from adaptdrive.cli.contact import read_address
from adaptdrive.config.services import Mqtt
from adaptdrive.errors import RefusedError


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
