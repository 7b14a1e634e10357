"""The configuration of the next run: what `reload` takes of the file, and what it refuses."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path

import pytest

from adaptdrive.app.reload import ANSWER_S, RunCourse, RunInput
from adaptdrive.config import load_configuration
from adaptdrive.runtime.requests import Reload
from adaptdrive.runtime.tick_support import ServiceManager
from adaptdrive.util import clock
from adaptdrive.util.errors import RefusedError

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    for name in ("motor.toml", "adaptdrive.dbc"):
        shutil.copy(EXAMPLES / name, tmp_path)
    return tmp_path / "motor.toml"


def at_once(read: Callable[[], RunInput], _: str) -> Future[RunInput]:
    """Read without a thread: virtual time would not wait for it."""
    future: Future[RunInput] = Future()
    try:
        future.set_result(read())
    except Exception as problem:  # noqa: BLE001 - as a thread would
        future.set_exception(problem)
    return future


@pytest.fixture
def course(path: Path, monkeypatch: pytest.MonkeyPatch) -> RunCourse:
    monkeypatch.setattr(clock, "in_thread", at_once)
    course = RunCourse(path, RunInput(load_configuration(path), path.read_text(encoding="utf-8")))
    assert course.next_run() is not None
    return course


async def test_a_file_without_a_change_is_taken(course: RunCourse) -> None:
    await course.prepare(Reload())


class Fed(ServiceManager):
    """Counts how often the watchdog is fed."""

    times = 0

    def feed(self, now_s: float) -> None:
        self.times += 1


async def test_between_two_runs_the_watchdog_is_fed_until_the_bus_is_open(
    course: RunCourse, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clock, "now_s", asyncio.get_running_loop().time)
    manager, opened, fed = Fed({}), asyncio.Event(), []

    async def look() -> None:
        await course.feed_between(manager)
        fed.append(manager.times)

    await look()
    (await course.prepare(Reload()))()
    await asyncio.sleep(ANSWER_S + 0.1)
    await look()
    opened.set()
    await course.opened(opened)
    await look()
    assert fed == [0, 1, 1]


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


@pytest.mark.parametrize(
    ("change", "measured", "reason"),
    [
        (("udp_port = 43113", "udp_port = 43114"), None, r"a change of \[bus\] needs a restart"),
        (("pole = 0.70", "pole = 0.71"), "0" * 64, "not the file whose model was measured"),
    ],
)
async def test_what_a_running_process_cannot_take_is_refused(
    course: RunCourse, path: Path, change: tuple[str, str], measured: str | None, reason: str
) -> None:
    _replace(path, *change)
    with pytest.raises(RefusedError, match=reason):
        await course.prepare(Reload(measured))


def _replace(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
