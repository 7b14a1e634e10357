"""The names, units and limits of a drive that operators see."""

from __future__ import annotations

from adaptdrive import __version__
from adaptdrive.app.interlocks import trip_limits
from adaptdrive.app.settings import daemon_settings
from adaptdrive.config import Configuration
from adaptdrive.control.signals import Mode
from adaptdrive.mqtt.contract import Output, Profile


def operator_profile(configuration: Configuration) -> Profile:
    """Return names, units and limits of a drive, which operators need in addition to its state."""
    load, drive = configuration.load, configuration.drive.limits
    trips, machine = trip_limits(configuration), daemon_settings(configuration).machine
    return Profile(
        drive=configuration.drive.name,
        output=Output(load.output_name, load.output_unit),
        manipulated=configuration.drive.given,
        limits={
            "setpoint": (load.reference_min, load.reference_max),
            "output_trip": (trips.output_min, trips.output_max),
            "pole": (machine.pole_min, machine.pole_max),
            "period_s": (machine.period_min_s, None),
            "boost_V": (drive.boost_reference_min_V, drive.boost_reference_max_V),
            "boost_trip_V": (None, trips.boost_voltage_max_V),
            "power_W": (None, drive.load_power_max_W),
        },
        modes=tuple(Mode),
        version=__version__,
    )
