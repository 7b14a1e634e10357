"""Reading a configuration file from a disk."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest
from pydantic import ValidationError

from adaptdrive.config import Configuration, load_configuration
from adaptdrive.config.bus import CanBus
from adaptdrive.config.file import read_text
from adaptdrive.util.errors import ConfigurationError
from tests.unit.config.documents import document, parse

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"


def can(configuration: Configuration) -> CanBus:
    """`[bus]`, known to be CAN."""
    assert isinstance(configuration.bus, CanBus)
    return configuration.bus


def test_a_small_file_is_enough(tmp_path: Path) -> None:
    file = tmp_path / "bench.toml"
    file.write_text(document(), encoding="utf-8")
    configuration = load_configuration(file)
    assert configuration.drive.name == "bench"
    assert configuration.load.pole == 0.70
    assert configuration.mqtt.host == "127.0.0.1"


def test_relative_paths_start_at_the_folder_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "bench.toml"
    text = document(
        mqtt__tls="true", mqtt__ca_file='"tls/ca.pem"', recording__directory='"sessions"'
    )
    file.write_text(text, encoding="utf-8")
    configuration = load_configuration(file)
    assert can(configuration).database == [tmp_path / "bench.dbc"]
    assert configuration.mqtt.ca_file == tmp_path / "tls" / "ca.pem"
    assert configuration.mqtt.password_file is None
    assert configuration.recording.directory == tmp_path / "sessions"


def test_a_name_alone_is_a_quantity_in_SI() -> None:
    named = parse(signals__output='"DriveLoad.Tachometer"').signals.output
    whole = parse(signals__output="{ signal = 'DriveLoad.Tachometer', scale = 1.0 }")
    assert named is not None
    assert named == whole.signals.output
    assert (named.signal, named.scale, named.offset) == ("DriveLoad.Tachometer", 1.0, 0.0)


def test_an_absolute_path_stays(tmp_path: Path) -> None:
    configuration = parse(bus__database=f'"{tmp_path}/x.dbc"')
    assert can(configuration).database == [tmp_path / "x.dbc"]


@pytest.mark.parametrize(
    ("frequency_Hz", "period_s", "ticks"), [(60, 1.0, 120), (50, 1.0, 100), (50, 60.0, 6000)]
)
def test_fast_ticks_in_a_slow_period(frequency_Hz: int, period_s: float, ticks: int) -> None:
    configuration = parse(drive__line_frequency_Hz=str(frequency_Hz), load__period_s=str(period_s))
    assert configuration.ticks_per_period == ticks


def test_a_configuration_cannot_be_changed() -> None:
    configuration = parse()
    with pytest.raises(ValidationError):
        configuration.load.pole = 0.8  # type: ignore[misc]


@pytest.mark.parametrize(
    "content",
    [
        pytest.param(None, id="missing"),
        pytest.param(b"drive = {", id="not TOML"),
        pytest.param(b"# \xff\xfe", id="not UTF-8"),
        pytest.param(b"", id="empty"),
    ],
)
def test_a_file_that_cannot_be_read_is_named(tmp_path: Path, content: bytes | None) -> None:
    file = tmp_path / "bench.toml"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(ConfigurationError, match=str(file)) as caught:
        load_configuration(file)
    assert caught.value.source == file


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path: Path) -> None:
    file = tmp_path / "bench.toml"
    file.write_bytes(b"\xef\xbb\xbf" + (EXAMPLES / "motor.toml").read_bytes())
    assert read_text(file) == (EXAMPLES / "motor.toml").read_text(encoding="utf-8")


def test_a_folder_is_no_configuration(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="directory"):
        load_configuration(tmp_path)


def test_a_pipe_is_read_once_its_writer_has_come(tmp_path: Path) -> None:
    pipe = tmp_path / "bench.toml"
    os.mkfifo(pipe)
    writer = threading.Timer(0.2, pipe.write_text, ["drive = 1"])
    writer.start()
    assert read_text(pipe) == "drive = 1"
    writer.join()


def test_a_pipe_with_a_writer_is_read_to_its_end() -> None:
    reader, writer = os.pipe()
    os.write(writer, b"drive = 1")
    os.close(writer)
    assert read_text(Path(f"/dev/fd/{reader}")) == "drive = 1"
    os.close(reader)


@pytest.mark.parametrize("file", sorted(EXAMPLES.glob("*.toml")), ids=lambda file: file.name)
def test_the_examples_are_valid_and_whole(file: Path) -> None:
    bus = load_configuration(file).bus
    assert bus.type != "can" or bus.database[0].is_file()
