"""Trusted estimates across a restart: the file, who writes it, and what is not believed."""

import asyncio
import json
import math
import os
from pathlib import Path

import pytest

from adaptdrive.app import checkpoint as cp
from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.config import Configuration
from adaptdrive.control.signals import Decision, Mode, Order, Snapshot, Stage
from adaptdrive.runtime.hub import Hub
from adaptdrive.runtime.reports import Event, LoadReport, Severity
from tests.config.documents import parse
from tests.runtime.bench import until

VALUES = (0.021, 20.0, 90.0)
CONFIGURATION = parse()
LOAD = build_load(CONFIGURATION)
SETTINGS = controller_settings(CONFIGURATION)


def recall(
    path: Path, configuration: Configuration = CONFIGURATION
) -> tuple[cp.Values | None, Event | None]:
    settings, load = controller_settings(configuration), build_load(configuration)
    return cp.recall(path, configuration, settings, load)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = cp.checkpoint_path(tmp_path, "bench")
    cp.write_checkpoint(path, cp.configuration_key(CONFIGURATION), LOAD.names, VALUES)
    return path


def test_what_was_written_is_read_to_the_last_bit(path: Path) -> None:
    values, event = recall(path)
    assert values == VALUES
    assert event is not None
    assert event.severity is Severity.INFO
    assert "gain 0.021" in event.detail
    assert list(path.parent.iterdir()) == [path]


def test_without_a_file_there_is_nothing_to_tell(tmp_path: Path) -> None:
    assert recall(tmp_path / "absent.json") == (None, None)


@pytest.mark.parametrize(
    "change",
    [
        {"load__model__tau_motor_s": "9.5"},
        {"estimator__tau_lambda_s": "5.0"},
        {"drive__name": '"other"'},
    ],
)
def test_another_configuration_does_not_take_it(path: Path, change: dict[str, str]) -> None:
    values, event = recall(path, parse(**change))
    assert values is None
    assert event is not None
    assert event.severity is Severity.WARNING
    assert "another configuration" in event.detail


def test_what_has_nothing_to_do_with_the_load_may_change(path: Path) -> None:
    assert recall(path, parse(mqtt__port="1884", supervisor__warm_up_s="60"))[0] == VALUES


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (b"", "damaged"),
        (b"\xff\xfe\x00", "damaged"),
        (b'{"format": 1', "damaged"),
        (b'{"format": 0, "gain": 1.0}', "format 0"),
        (b'{"format": 1}', "damaged"),
        (b"[]", "damaged"),
    ],
)
def test_a_damaged_or_older_file_is_ignored_with_a_warning(
    path: Path, text: bytes, problem: str
) -> None:
    path.write_bytes(text)
    values, event = recall(path)
    assert values is None
    assert event is not None
    assert event.severity is Severity.WARNING
    assert problem in event.detail


@pytest.mark.parametrize(
    ("name", "value"), [("gain", 1.0), ("gain", -0.02), ("tau_sum_s", 0.0), ("extra", 1.0)]
)
def test_estimates_that_cannot_be_are_ignored(path: Path, name: str, value: float) -> None:
    content = json.loads(path.read_bytes())
    content["estimates"][name] = value
    path.write_text(json.dumps(content))
    values, event = recall(path)
    assert values is None
    assert event is not None
    assert name in event.detail


def test_the_paper_and_direct_least_squares_start_afresh(path: Path) -> None:
    for change in ({"load__design": '"paper"'}, {"estimator__method": '"rls"'}):
        assert recall(path, parse(**change)) == (None, None)


def test_a_write_that_is_cut_short_leaves_the_old_file(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError, match="No space"):
        cp.write_checkpoint(path, "key", LOAD.names, (1.0, 2.0, 3.0))
    assert recall(path)[0] == VALUES


class Learner:
    """A source of estimates that are set by hand."""

    def __init__(self) -> None:
        self.trusted: cp.Values | None = None


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def report() -> LoadReport:
    order = Order(Stage.RUN, 3.0, Mode.ADAPTIVE, 0.7)
    snapshot = Snapshot(1, 120, 1.0, order, 3.0, (3.0, 3.0), (280.0,) * 3, 280.0, True, 0)
    decision = Decision(1, 280.0, Mode.ADAPTIVE, True, "", {}, (), 0.0, 0.0, math.nan)
    return LoadReport(snapshot, decision)


async def test_it_is_written_on_acceptance_at_most_once_a_minute_and_at_the_end() -> None:
    hub, clock, learner = Hub(), Clock(), Learner()
    written: list[cp.Values] = []
    keeper = cp.Keeper(written.append, learner, hub, clock)

    async def period(now_s: float, trusted: cp.Values | None, *expected: cp.Values) -> None:
        clock.now_s, learner.trusted = now_s, trusted
        hub.publish(report())
        await asyncio.sleep(0.05)
        await until(lambda: len(written) >= len(expected))
        assert written == list(expected)

    task = asyncio.create_task(keeper.run())
    await period(1.0, None)
    await period(2.0, (1.0,), (1.0,))
    await period(61.0, (2.0,), (1.0,))
    await period(62.0, (3.0,), (1.0,), (3.0,))
    await period(200.0, (3.0,), (1.0,), (3.0,))
    learner.trusted = (4.0,)
    task.cancel()
    await keeper.save()
    await keeper.save()
    assert written == [(1.0,), (3.0,), (4.0,)]


async def test_a_full_disk_is_told_once_and_stops_nothing() -> None:
    hub, clock, learner = Hub(), Clock(), Learner()
    events = hub.subscribe(Event, size=10)

    def refuse(_: cp.Values) -> None:
        raise OSError(28, "No space left on device")

    keeper = cp.Keeper(refuse, learner, hub, clock)
    for value in (1.0, 2.0, 3.0):
        learner.trusted = (value,)
        await keeper.save()
    (event,) = events.drain()
    assert isinstance(event, Event)
    assert event.severity is Severity.WARNING
    assert "No space left" in event.detail
