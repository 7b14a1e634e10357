"""The configuration of the next run: what `reload` takes of the file, and what it refuses."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from adaptdrive.app.reload import Given, RunCourse
from adaptdrive.config import load_configuration
from adaptdrive.errors import RefusedError
from adaptdrive.runtime.requests import Reload

EXAMPLES = Path(__file__).parents[2] / "deploy" / "examples"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    for name in ("motor.toml", "adaptdrive.dbc"):
        shutil.copy(EXAMPLES / name, tmp_path)
    return tmp_path / "motor.toml"


@pytest.fixture
def course(path: Path) -> RunCourse:
    course = RunCourse(path, Given(load_configuration(path), path.read_text(encoding="utf-8")))
    assert course.next_run() is not None
    return course


async def test_a_file_without_a_change_is_taken(course: RunCourse) -> None:
    await course.prepare(Reload())


async def test_another_scale_in_the_dbc_needs_a_restart(course: RunCourse, path: Path) -> None:
    """The same name, another meaning: the bus would be read with the scales of before."""
    database = path.with_name("adaptdrive.dbc")
    text = database.read_text(encoding="cp1252")
    database.write_text(
        text.replace("BoostVoltage : 0|16@1+ (0.01,", "BoostVoltage : 0|16@1+ (0.0101,"),
        encoding="cp1252",
    )
    assert database.read_text(encoding="cp1252") != text
    with pytest.raises(RefusedError, match="a changed DBC or EDS file needs a restart"):
        await course.prepare(Reload())
