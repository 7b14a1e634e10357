"""The options that all operator commands share."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from adaptdrive.cli.options import Contact
from adaptdrive.util.errors import ConfigurationError
from tests.system.daemon.site import motor_configuration


def test_options_go_before_the_configuration(tmp_path: Path) -> None:
    path = tmp_path / "motor.toml"
    changes = {
        "mqtt.host": '"site"',
        "mqtt.tls": "true",
        "mqtt.ca_file": '"ca.crt"',
        "mqtt.username": '"motor"',
    }
    path.write_text(motor_configuration(8884, 1, changes), encoding="utf-8")
    plain = Contact(config=path).settings
    assert (plain.host, plain.port, plain.tls) == ("site", 8884, True)
    assert plain.ca_file == tmp_path / "ca.crt"
    assert plain.username is None
    own = Contact(config=path, broker="desk", username="operator").settings
    assert (own.host, own.port, own.tls, own.ca_file) == ("desk", 1883, False, None)
    assert own.username == "operator"


@pytest.mark.parametrize(
    ("contact", "place"),
    [
        (Contact(), ("127.0.0.1", 1883, False)),
        (Contact(tls=True), ("127.0.0.1", 8883, True)),
        (Contact(broker="[::1]:99"), ("::1", 99, False)),
        (Contact(broker="desk", tls=True), ("desk", 8883, True)),
    ],
)
def test_the_usual_broker(contact: Contact, place: tuple[str, int, bool]) -> None:
    settings = contact.settings
    assert (settings.host, settings.port, settings.tls) == place


def test_an_unusable_configuration_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="motor"):
        _ = Contact(config=tmp_path / "motor.toml").settings


def test_a_flaw_in_another_section_does_not_keep_a_stop_from_its_broker(tmp_path: Path) -> None:
    path = tmp_path / "motor.toml"
    path.write_text('[mqtt]\nhost = "::1"\nport = 1999\n[drive]\nname = 7\n[nonsense]\n')
    found = Contact(config=path).settings
    assert (found.host, found.port, found.tls, found.ca_file) == ("::1", 1999, False, None)


@pytest.mark.parametrize(
    ("line", "place"),
    [
        ("port = 0", "mqtt.port"),
        ("port = '1883'", "mqtt.port"),
        ("tls = 'no'", "mqtt.tls"),
        ("host = 'a b'", "mqtt.host"),
        ("host = 7", "mqtt.host"),
        ("ca_file = 7", "mqtt.ca_file"),
    ],
)
def test_a_broker_that_cannot_be_used_is_named_with_its_place(
    tmp_path: Path, line: str, place: str
) -> None:
    path = tmp_path / "motor.toml"
    path.write_text(f"[mqtt]\n{line}\n")
    with pytest.raises(ConfigurationError, match=place):
        _ = Contact(config=path).settings


@pytest.mark.usefixtures("outside")
@pytest.mark.parametrize("verb", ["disable", "status"])
def test_a_command_over_mqtt_reads_no_whole_configuration(tmp_path: Path, verb: str) -> None:
    """A stop that takes ten seconds on a busy laptop is none."""
    path = tmp_path / "motor.toml"
    path.write_text("[mqtt]\nport = 1\n")
    program = (
        "import sys; from adaptdrive.cli import main;"
        f"main(['{verb}', 'pump', '--config', {str(path)!r}]);"
        "print(sorted({'pydantic', 'pyarrow', 'rich', 'numpy', 'cantools'} & sys.modules.keys()))"
    )
    ran = subprocess.run(
        [sys.executable, "-c", program], check=False, capture_output=True, text=True
    )
    assert ran.stdout.splitlines()[-1] == "[]"
    assert "127.0.0.1:1" in ran.stderr
