"""The rows of the health of a load: from estimates of the real estimator to a drive's file."""

from __future__ import annotations

import fcntl
import math
import re
import sys
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import msgspec
import numpy as np
import pytest

from adaptdrive.app.loads import build_load
from adaptdrive.config import load_configuration
from adaptdrive.control.loads.load import derived
from adaptdrive.control.signals import Estimate, Stage
from adaptdrive.recording import archiver, health
from adaptdrive.recording.archive import archive
from adaptdrive.recording.health import HourRow
from adaptdrive.recording.log_files import log_files
from adaptdrive.recording.records import Header, HealthSettings
from adaptdrive.recording.segments import prune
from adaptdrive.recording.session import create_session, session_directories
from adaptdrive.runtime.reports import Event, LoadReport, Severity
from adaptdrive.util.clock import now_s
from adaptdrive.util.trends import HealthReport
from tests.unit.recording.material import INFO, make_batch, make_tick, write_log
from tests.unit.recording.months import BEGIN, SETTINGS, TRUTH, months, motor_hours

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
START = BEGIN + timedelta(minutes=30)


@pytest.fixture(scope="module")
def steps() -> list[LoadReport]:
    """Two hours and a half of slow steps of the real estimator."""
    return motor_hours(2.5, seed=3)


class Place:
    """A drive whose session began at half past."""

    def __init__(self, folder: Path, settings: HealthSettings = SETTINGS) -> None:
        self.log, self.sessions = folder / "motor.log", folder / "sessions"
        info = msgspec.structs.replace(INFO, started=START, log="../motor.log")
        self.header = Header(info, "# as configured\n", sessions="sessions", health=settings)
        self.published: list[object] = []
        create_session(self.sessions, info, self.header.config_text)

    def write(self, steps: list[LoadReport], part: int, *, last: bool = False) -> None:
        batch = make_batch([make_tick(120 * part)], steps, last=last)
        moved = msgspec.structs.replace(batch, utc_offset_s=START.timestamp())
        write_log(self.log, self.header, moved, part=part)

    def archive(self, *, live: bool = False) -> list[HourRow]:
        with log_files(self.log)[-1].path.open("rb") as held:
            if live:
                fcntl.flock(held, fcntl.LOCK_EX)  # as its daemon does
            archive(self.log, now_s(), 10.0, lambda *_: None, self.published.append)
        return self.rows

    @property
    def rows(self) -> list[HourRow]:
        return health.read_rows(health.health_path(self.sessions, "motor"))


def test_a_session_leaves_a_row_for_each_hour_of_the_clock(
    tmp_path: Path, steps: list[LoadReport]
) -> None:
    place = Place(tmp_path)
    for part in range(3):
        chosen = [one for one in steps if one.time_s // 3600 == part]
        place.write(chosen, part + 1, last=part == 2)
    rows = place.archive()
    assert [one.time for one in rows] == [BEGIN + timedelta(hours=n) for n in range(3)]
    assert [one.starts for one in rows] == [1, 0, 0]
    assert sum(one.running_h for one in rows) == pytest.approx(2.5, abs=0.01)
    for row in rows:
        assert {*row.means} == {*TRUTH}
        for name, (value, std) in row.means.items():
            assert abs(value - TRUTH[name]) < 5.0 * std, name
            assert std < 0.2 * abs(TRUTH[name])
    before = place.rows
    assert place.archive() == rows
    assert place.rows == before


def test_an_hour_has_its_row_once_it_is_complete(tmp_path: Path, steps: list[LoadReport]) -> None:
    """However the segments lie, and while the session goes on."""
    whole, parts = Place(tmp_path / "whole"), Place(tmp_path / "parts")
    whole.write(steps, 1, last=True)
    seen = []
    for part in range(8):
        chosen = [one for one in steps if one.time_s // 1200 == part]
        parts.write(chosen, part + 1, last=part == 7)
        seen.append(len(parts.archive(live=part < 7)))
    assert seen == [0, 0, 1, 1, 1, 2, 2, 3]
    assert [one.time for one in parts.archive()] == [one.time for one in whole.archive()]
    for one, other in zip(parts.archive(), whole.archive(), strict=True):
        assert one == other


def test_a_bound_that_is_left_is_reported_once_with_the_condition(
    tmp_path: Path, steps: list[LoadReport]
) -> None:
    """The weeks before are those of a load whose friction is beyond its bound."""
    bounds = {"friction": (-math.inf, 0.9 * TRUTH["friction"])}
    place = Place(tmp_path, msgspec.structs.replace(SETTINGS, bounds=bounds))
    weeks = [
        msgspec.structs.replace(one, time=one.time - timedelta(weeks=4)) for one in months(4.0, 1)
    ]
    health.append_rows(health.health_path(place.sessions, "motor"), weeks)
    place.write(steps, 1)
    place.archive()
    event, report = place.published
    assert isinstance(event, Event)
    assert (event.kind, event.severity) == ("health", Severity.WARNING)
    said = r"dry friction and load torque: friction = 19\.9\d+ ± 0\.\d+, over"
    assert re.match(said, event.detail)
    assert event.detail.endswith("above its bound of 18")
    assert isinstance(report, HealthReport)
    assert [name for name, one in report.quantities.items() if one.outside] == ["friction"]
    assert report.quantities["friction"].value == pytest.approx(20.0, rel=0.02)
    assert report.time == BEGIN + timedelta(hours=2)
    place.published.clear()
    place.archive()
    assert [type(one) for one in place.published] == [HealthReport]


@pytest.mark.usefixtures("outside")
def test_the_archiver_process_reports_the_condition_on_a_line(
    tmp_path: Path, steps: list[LoadReport]
) -> None:
    place = Place(tmp_path)
    place.write(steps, 1, last=True)
    command = [sys.executable, "-m", "adaptdrive.recording.archiver", str(place.log), "10"]
    heard: list[archiver.Line] = []
    assert archiver._run(command, heard.append) == ""
    (report,) = heard
    assert isinstance(report, HealthReport)
    assert {*report.quantities} == {*TRUTH}
    assert report.courses["inertia"] == (0.0,)


def test_at_rest_an_hour_has_no_value(tmp_path: Path, steps: list[LoadReport]) -> None:
    place = Place(tmp_path)
    unknown = Estimate(21.0, 30.0)  # as it is shown after some periods at rest
    rested = [
        replace(
            one,
            decision=replace(
                one.decision,
                estimates=one.decision.estimates
                | dict.fromkeys(("tau_sum_s", "tau_product_s2"), unknown),
            ),
        )
        for one in steps[:1000]
    ]
    place.write(rested, 1, last=True)
    (row,) = place.archive()
    assert row.means == {}
    assert row.running_h == pytest.approx(1000 / 3600, rel=1e-3)


def test_a_start_is_counted_across_hours(tmp_path: Path, steps: list[LoadReport]) -> None:
    place = Place(tmp_path)
    off = [
        replace(
            one, snapshot=replace(one.snapshot, order=replace(one.snapshot.order, stage=Stage.OFF))
        )
        if one.time_s % 1800 > 1500
        else one
        for one in steps
    ]
    place.write(off, 1, last=True)
    rows = place.archive()
    assert [one.starts for one in rows] == [1, 2, 2]
    assert rows[1].running_h == pytest.approx(3000 / 3600, rel=1e-2)


def test_rows_survive_the_removal_of_sessions_and_a_torn_line(tmp_path: Path) -> None:
    path = health.health_path(tmp_path, "motor")
    first = HourRow(BEGIN, START, 1.0, 1, {"gain": (0.011, 1e-5)}, ("load",))
    second = msgspec.structs.replace(first, outside=("gain",))
    health.append_rows(path, [first])
    with path.open("ab") as file:
        file.write(b'\n{"time":"2026')
    health.append_rows(path, [second])
    health.append_rows(path, [first])
    assert health.read_rows(path) == [first, second, first]
    assert list(session_directories(tmp_path)) == []
    assert list(prune(tmp_path, Header(INFO, "").keep, BEGIN)) == []


@pytest.mark.parametrize(
    "wrong",
    [
        '"time":"2026-01-05T00:00:00"',
        '"time":"2099-01-01T00:00:00Z"',
        '"means":{"gain":[0.011,0.0]}',
        '"means":{"gain":[0.011,1e-200]}',
        '"means":{"gain":[1e308,1.0]}',
        '"means":{"gain":[0.011,-1.0]}',
    ],
)
def test_a_row_that_no_clock_and_no_estimate_can_have_made_is_left_out(
    tmp_path: Path, wrong: str
) -> None:
    path = health.health_path(tmp_path, "motor")
    row = HourRow(BEGIN, START, 1.0, 1, {"gain": (0.011, 1e-5)})
    name, value = wrong.split(":", 1)
    whole = msgspec.json.decode(msgspec.json.encode(row)) | msgspec.json.decode(
        f"{{{name}:{value}}}"
    )
    path.write_bytes(msgspec.json.encode(whole))
    health.append_rows(path, [row])
    assert health.read_rows(path) == [row]


@pytest.mark.parametrize("rise", [0.11, 0.5, 2.0])
def test_a_sudden_change_leaves_its_bound_within_eight_days(rise: float) -> None:
    rows, days = list[HourRow](), list[int]()
    generator = np.random.default_rng(1)
    settings = msgspec.structs.replace(SETTINGS, bounds={"gain": (-math.inf, 1.1)})
    for hour in range(24 * 60):
        value = 1.0 + rise * (hour >= 24 * 40) + generator.normal(0.0, 0.002)
        time = BEGIN + timedelta(hours=hour)
        rows.append(HourRow(time, START, 1.0, 0, {"gain": (value, 0.002)}))
        if hour % 24 == 0 and health.crossings(rows, (), settings)[0]:
            days.append(hour // 24)
    assert 40 < days[0] <= 48


@pytest.mark.parametrize("load", ["motor", "bath", "battery"])
def test_what_a_load_is_follows_from_its_parameters(load: str) -> None:
    """The products are those of the plants: J of a motor, C of a bath, resistances of a cell."""
    estimates = {
        "motor": {"gain": 0.5, "tau_product_s2": 40.0, "tau_sum_s": 14.0, "input_offset": -3.0},
        "bath": {"resistance_K_per_W": 0.02, "tau_s": 500.0, "input_offset": -30.0},
        "battery": {"direct_S": 4.0, "gain_S": 2.0, "tau_s": 30.0, "input_offset": -48.0},
    }[load]
    expected = {
        "motor": {"inertia": 80.0, "damping": 2.0, "friction": 3.0},
        "bath": {"heat_capacity": 25_000.0, "conductance": 50.0, "heat_loss": 30.0},
        "battery": {"series_resistance": 0.25, "resistance": 0.5, "emf": 48.0},
    }[load]
    built = build_load(load_configuration(EXAMPLES / f"{load}.toml"))
    assert derived(built.products, built.loss, estimates) == pytest.approx(expected)
    assert math.isfinite(sum(expected.values()))
