"""Trusted estimates across a restart: the record, who writes it, and what is not believed."""

import asyncio
import json
import math
import re
from pathlib import Path

import pytest

from adaptdrive.app import recording as cp
from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.config import Configuration, parse_configuration
from adaptdrive.control.controller import Controller
from adaptdrive.control.signals import Decision, Measurement, Mode, Order, Snapshot, Stage
from adaptdrive.runtime.reports import Event, Hub, LoadReport, Severity
from tests.unit.config.documents import parse
from tests.unit.runtime.bench import until

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
VALUES = (0.021, 20.0, 90.0)
RESOLUTION = 0.0049
CONFIGURATION = parse()
LOAD = build_load(CONFIGURATION)
SETTINGS = controller_settings(CONFIGURATION)


def recall(
    record: bytes, configuration: Configuration = CONFIGURATION
) -> tuple[cp.Values | None, Event | None]:
    learnt, event = recall_all(record, configuration)
    return learnt.values, event


def recall_all(
    record: bytes, configuration: Configuration = CONFIGURATION
) -> tuple[cp.Learnt, Event | None]:
    settings, load = controller_settings(configuration), build_load(configuration)
    return cp.recall(record, configuration, settings, load)


@pytest.fixture
def record() -> bytes:
    return recorded(cp.Learnt(VALUES, RESOLUTION))


def recorded(learnt: cp.Learnt, configuration: Configuration = CONFIGURATION) -> bytes:
    return cp.checkpoint_record(cp.configuration_key(configuration), LOAD.names, learnt)


def test_what_was_written_is_read_to_the_last_bit(record: bytes) -> None:
    values, event = recall(record)
    assert values == VALUES
    assert event is not None
    assert event.severity is Severity.INFO
    assert "gain 0.021" in event.detail
    assert recall_all(record)[0] == cp.Learnt(VALUES, RESOLUTION)


@pytest.mark.parametrize("resolution", [-0.01, 6.0, 1e300, "1e400"])
def test_a_resolution_that_cannot_be_is_ignored_with_its_estimates(
    record: bytes, resolution: float | str
) -> None:
    learnt, event = recall_all(record.replace(str(RESOLUTION).encode(), str(resolution).encode()))
    assert learnt == cp.Learnt()
    assert event is not None
    assert event.severity is Severity.WARNING


def test_without_a_record_there_is_nothing_to_report() -> None:
    assert recall(b"") == (None, None)


@pytest.mark.parametrize(
    "change",
    [
        {"drive__name": '"other"'},
        {"signals__output__scale": "0.9"},
        {"bus__channel": '"plant"'},
    ],
)
def test_another_configuration_does_not_take_it(record: bytes, change: dict[str, str]) -> None:
    values, event = recall(record, parse(**change))
    assert values is None
    assert event is not None
    assert event.severity is Severity.WARNING
    assert "another configuration" in event.detail


def test_a_message_with_another_scale_does_not_take_it(tmp_path: Path) -> None:
    database = tmp_path / "bench.dbc"
    configuration = parse(bus__database=f'"{database}"')
    database.write_bytes((EXAMPLES / "adaptdrive.dbc").read_bytes())
    record = recorded(cp.Learnt(VALUES), configuration)
    moved = database.rename(tmp_path / "moved.dbc")
    assert recall(record, parse(bus__database=f'"{moved}"'))[0] == VALUES
    moved.write_bytes(moved.read_bytes().replace(b"(0.000001,0)", b"(0.000002,0)"))
    assert recall(record, parse(bus__database=f'"{moved}"'))[0] is None


def test_what_has_nothing_to_do_with_the_load_may_change(record: bytes) -> None:
    assert recall(record, parse(mqtt__port="1884", supervisor__warm_up_s="60"))[0] == VALUES


@pytest.mark.parametrize(
    "change",
    [
        {"load__model__tau_motor_s": "9.5"},
        {"load__period_s": "2.0"},
        {"load__pole": "0.8"},
        {"estimator__tau_lambda_s": "5.0"},
        {"supervisor__ratio_max": "8.0"},
    ],
)
def test_what_commissioning_writes_may_change(record: bytes, change: dict[str, str]) -> None:
    assert recall(record, parse(**change))[0] == VALUES


def test_another_input_map_of_a_bath_does_not_take_it() -> None:
    source = EXAMPLES / "bath.toml"
    text = source.read_text(encoding="utf-8")
    other = re.sub("heater_Ohm = .*", "heater_Ohm = 9.5", text)
    slower = re.sub("(?m)^tau_s = .*", "tau_s = 300.0", text)
    assert len({text, other, slower}) == 3
    keys = [cp.configuration_key(parse_configuration(one, source)) for one in (text, other, slower)]
    assert keys[0] == keys[2] != keys[1]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (b"\xff\xfe\x00", "damaged"),
        (b'{"key": 1', "damaged"),
        (b'{"key": "", "gain": 1.0}', "damaged"),
        (b"[]", "damaged"),
    ],
)
def test_a_damaged_record_is_ignored_with_a_warning(text: bytes, problem: str) -> None:
    values, event = recall(text)
    assert values is None
    assert event is not None
    assert event.severity is Severity.WARNING
    assert problem in event.detail


@pytest.mark.parametrize(
    ("name", "value"), [("gain", 1.0), ("gain", -0.02), ("tau_sum_s", 0.0), ("extra", 1.0)]
)
def test_estimates_that_cannot_be_are_ignored(record: bytes, name: str, value: float) -> None:
    content = json.loads(record)
    content["estimates"][name] = value
    values, event = recall(json.dumps(content).encode())
    assert values is None
    assert event is not None
    assert name in event.detail


def test_the_paper_and_direct_least_squares_start_afresh(record: bytes) -> None:
    for change in ({"load__design": '"paper"'}, {"estimator__method": '"rls"'}):
        assert recall(record, parse(**change)) == (None, None)


class Learner:
    """A source of estimates that are set by hand."""

    def __init__(self) -> None:
        self.trusted: cp.Values | None = None
        self.resolution = 0.0

    def __call__(self) -> cp.Learnt:
        return cp.Learnt(self.trusted, self.resolution)


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
    written: list[cp.Values | None] = []
    keeping = cp.keep_learnt(lambda one: written.append(one.values), learner, hub, clock)

    async def period(now_s: float, trusted: cp.Values | None, *expected: cp.Values) -> None:
        clock.now_s, learner.trusted = now_s, trusted
        hub.publish(report())
        await asyncio.sleep(0.05)
        await until(lambda: len(written) >= len(expected))
        assert written == list(expected)

    task = asyncio.create_task(keeping)
    await period(1.0, None)
    await period(2.0, (1.0,), (1.0,))
    await period(61.0, (2.0,), (1.0,))
    await period(62.0, (3.0,), (1.0,), (3.0,))
    await period(200.0, (3.0,), (1.0,), (3.0,))
    learner.resolution = RESOLUTION
    await period(300.0, (3.0,), (1.0,), (3.0,), (3.0,))
    learner.trusted = (4.0,)
    task.cancel()
    await asyncio.wait([task])
    assert written == [(1.0,), (3.0,), (3.0,), (4.0,)]


def test_a_restarted_daemon_knows_the_resolution_of_its_sensor_from_the_first_period() -> None:
    """Through the record, on a tachometer of 10 mV: the run before found it."""
    step = 0.01
    first = Controller(SETTINGS, LOAD, VALUES)
    assert rested(first, [2.0 + 0.01 * n for n in range(40)])[0].resolution == 0.0
    assert first.resolution == pytest.approx(step, rel=0.01)
    learnt, _ = recall_all(recorded(cp.Learnt(VALUES, first.resolution)))
    again = Controller(SETTINGS, LOAD, learnt.values, learnt.resolution)
    snapshots = rested(again, [2.0] * 40)
    assert {one.resolution for one in snapshots} == {first.resolution}
    assert snapshots[0].rounding == pytest.approx(step / math.sqrt(12.0), rel=0.01)


def rested(controller: Controller, outputs: list[float]) -> list[Snapshot]:
    """Snapshots of a controller whose sensor shows each of these outputs for ten ticks."""
    shown, found = Order(Stage.RUN, 2.0, Mode.FIXED, 0.7), []
    for n in range(10 * len(outputs)):
        sample = Measurement(n, 1.0 / 120.0, 200.0, 120.0, 0.0, outputs[n // 10])
        controller.tick(sample, shown)
        found.append(controller.take_snapshot())
    return [one for one in found if one is not None]
