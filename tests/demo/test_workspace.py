"""The folder of a demonstration, and the configuration that is written into it."""

from __future__ import annotations

import string
import tomllib
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptdrive.config.file import load_configuration
from adaptdrive_sim.broker import BrokerAddress
from adaptdrive_sim.demo.bus import BusChoice, choose_bus
from adaptdrive_sim.demo.settings import DemoError, DemoSettings
from adaptdrive_sim.demo.toml_text import toml_text
from adaptdrive_sim.demo.workspace import Workspace, make_workspace

BUS = BusChoice("udp_multicast", "239.74.163.9", 45678)
BROKER = BrokerAddress("127.0.0.1", 45679)
NOW = datetime(2026, 11, 21, 12, 34, 56, tzinfo=UTC)

KEYS = st.text(string.ascii_letters + string.digits + "_-", min_size=1)
# TOML has no surrogates, and JSON's escapes end at the basic plane.
TEXTS = st.text(st.characters(exclude_categories=["Cs"], max_codepoint=0xFFFF))
SCALARS = st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | TEXTS
VALUES = SCALARS | st.lists(SCALARS, max_size=3)
DOCUMENTS = st.dictionaries(
    KEYS,
    st.recursive(VALUES, lambda inner: st.dictionaries(KEYS, inner, max_size=3), max_leaves=8),
)


def made(directory: Path) -> Workspace:
    return make_workspace(DemoSettings(directory=directory), BUS, BROKER, NOW)


@given(DOCUMENTS)
def test_what_is_written_as_toml_reads_back(document: dict[str, object]) -> None:
    assert tomllib.loads(toml_text(document)) == document


def test_the_configuration_is_valid_and_has_this_bus_and_broker(tmp_path: Path) -> None:
    workspace = made(tmp_path / "run")
    configuration = load_configuration(workspace.configuration)
    assert configuration.drive.name == "motor"
    assert configuration.mqtt.port == 45679
    assert configuration.recording.directory == tmp_path / "run" / "sessions"
    bus = tomllib.loads(workspace.configuration.read_text())["bus"]
    assert (bus["interface"], bus["channel"]) == ("udp_multicast", "239.74.163.9")
    assert bus["udp_port"] == 45678
    assert (tmp_path / "run" / bus["database"]).read_text().startswith("VERSION")


def test_the_usual_folder_is_named_after_the_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    workspace = make_workspace(DemoSettings(), BUS, BROKER, NOW)
    assert workspace.directory == tmp_path / "build" / "demo" / "20261121T123456Z"


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DemoError, match="file/run"):
        made(tmp_path / "file" / "run")


def test_two_demonstrations_get_different_buses() -> None:
    one, other = (choose_bus("udp_multicast", None) for _ in range(2))
    assert one.udp_port != other.udp_port


def test_a_bus_that_is_asked_for_is_taken() -> None:
    assert choose_bus("socketcan", "can7").channel == "can7"
    assert str(choose_bus("socketcan", None)) == "socketcan vcan0"
    assert choose_bus("udp_multicast", "239.1.2.3").channel == "239.1.2.3"
