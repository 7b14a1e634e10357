import pytest

from adaptdrive.analysis.replay import reconfigured
from adaptdrive.config import Configuration
from adaptdrive.util.errors import ConfigurationError
from tests.unit.config.documents import SOURCE, document


def what_if(*settings: str) -> Configuration:
    return reconfigured(document(load__type='"motor"'), SOURCE, settings)


def flaw(*settings: str) -> str:
    with pytest.raises(ConfigurationError) as caught:
        what_if(*settings)
    return str(caught.value)


def test_no_setting_leaves_the_configuration_as_it_was() -> None:
    assert what_if().load.pole == 0.7


def test_settings_keep_their_types() -> None:
    changed = what_if(
        "estimator.forgetting=0.95",
        "load.samples = 30",
        "mqtt.tls=true",
        "load.design=paper",
        'drive.name="other"',
        "interlocks.output_max=9",
    )
    assert changed.estimator.forgetting == 0.95
    assert changed.load.samples == 30
    assert changed.mqtt.tls is True
    assert changed.load.design == "paper"
    assert changed.drive.name == "other"
    assert changed.interlocks.output_max == 9.0


def test_the_last_of_two_settings_of_one_key_holds() -> None:
    assert what_if("load.pole=0.8", "load.pole=0.9").load.pole == 0.9


@pytest.mark.parametrize(
    ("setting", "key", "problem"),
    [
        ("estimator.forgeting=0.95", "estimator.forgeting", "Unknown key"),
        ("estimator.forgetting=2", "estimator.forgetting", "less than or equal to 1"),
        ("estimator.forgetting=much", "estimator.forgetting", "'much'"),
        ("interlocks.stop_s.fast=1", "stop_s", "valid number"),
        ("estimators.forgetting=0.95", "estimators", "Unknown key"),
        ("estimator.forgetting", "estimator.forgetting", "is not KEY=VALUE"),
        ("=0.95", "=0.95", "is not KEY=VALUE"),
        ("drive.name.first=a", "drive.name.first", "drive.name is a value"),
        ("load.pole=0.8\ndrive.kind='bidirectional'", "pole", "control characters"),
    ],
)
def test_a_setting_that_cannot_hold_is_named(setting: str, key: str, problem: str) -> None:
    message = flaw(setting)
    assert key in message
    assert problem in message


def test_a_configuration_that_is_no_toml_is_an_error() -> None:
    with pytest.raises(ConfigurationError, match="TOML"):
        reconfigured("[", SOURCE, [])
