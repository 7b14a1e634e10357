"""Folder, bus, ports and name of a demonstration, which no other one has."""

from __future__ import annotations

import asyncio
import tomllib
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from adaptdrive.config.file import load_configuration
from adaptdrive.processes import Ports
from adaptdrive_sim.demo import DemoError, DemoSettings
from adaptdrive_sim.demo.stages import RealStage
from adaptdrive_sim.demo.story import read_story

pytestmark = pytest.mark.usefixtures("outside")


@contextmanager
def stage(directory: Path | None = None) -> Iterator[RealStage]:
    settings = DemoSettings(directory=directory)
    with closing(RealStage(read_story("motor"), settings)) as made:
        yield made


def test_the_configuration_is_valid_and_has_this_bus_and_broker(tmp_path: Path) -> None:
    with stage(tmp_path / "run") as made:
        configuration = load_configuration(made.configuration)
    assert configuration.drive.name == "motor"
    assert f"127.0.0.1:{configuration.mqtt.port}" == made.broker
    assert configuration.recording.directory == tmp_path / "run" / "sessions"
    bus = tomllib.loads(made.configuration.read_text())["bus"]
    assert f"{bus['interface']} {bus['channel']}:{bus['udp_port']}" == made.places["bus"]
    assert (tmp_path / "run" / bus["database"]).read_text().startswith("VERSION")


def test_two_demonstrations_in_one_second_share_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with stage() as one, stage() as other:
        assert one.directory != other.directory
        assert one.directory.parent == tmp_path / "build" / "demo"
        assert one.places["bus"] != other.places["bus"]
        assert one.broker != other.broker


async def test_a_port_that_is_held_can_be_listened_at_and_is_given_to_nobody_else() -> None:
    ports = Ports()
    try:
        taken = [ports.take() for _ in range(50)]
        assert len(set(taken)) == 50
        server = await asyncio.start_server(lambda _, __: None, "127.0.0.1", taken[0])
        server.close()
        await server.wait_closed()
    finally:
        ports.close()


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DemoError, match="file"), stage(tmp_path / "file" / "run"):
        pass
