from pathlib import Path

import pytest

from adaptdrive import __version__
from adaptdrive.app.settings import operator_profile
from adaptdrive.config.file import load_configuration
from adaptdrive.mqtt.contract import Output

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"


@pytest.mark.parametrize(
    ("name", "output"),
    [("motor", Output("speed", "V")), ("bath", Output("temperature", "K"))],
)
def test_the_profile_has_names_units_and_limits_of_the_configuration(
    name: str, output: Output
) -> None:
    configuration = load_configuration(EXAMPLES / f"{name}.toml")
    profile = operator_profile(configuration)
    load = configuration.load
    assert (profile.drive, profile.output, profile.version) == (name, output, __version__)
    assert profile.limits is not None
    assert profile.limits["setpoint"] == (load.reference_min, load.reference_max)
    assert profile.limits["boost_trip_V"] == (None, configuration.interlocks.boost_voltage_max_V)
