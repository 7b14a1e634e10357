"""Identification of a recorded session against the plant that was simulated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from adaptdrive.analysis.excerpts import read_stretches
from adaptdrive.analysis.load_report import as_json, as_text
from adaptdrive.analysis.record import RecordLoad, identify_session
from adaptdrive.recording.reader import read_session
from adaptdrive.recording.records import Header
from adaptdrive.recording.session import create_session
from adaptdrive.util.errors import IdentificationError
from adaptdrive_sim.plants.motor import Motor, MotorParameters
from tests.unit.app.test_replay import lived
from tests.unit.recording.material import INFO, make_batch, make_tick, record_messages


@pytest.fixture(scope="module")
def found(session_path: Path) -> RecordLoad:
    return identify_session(read_session(session_path))[0]


def test_the_load_behind_a_session_is_found(found: RecordLoad) -> None:
    true = Motor(MotorParameters(), disks=3).model(0.25, 1.0)
    gain, total_s, product_s2 = found.load.parameters.values()
    taus_s = true["tau_motor_s"], true["tau_filter_s"]
    assert gain.value == pytest.approx(true["gain"], abs=3.0 * gain.std)
    assert total_s.value == pytest.approx(sum(taus_s), abs=3.0 * total_s.std)
    assert product_s2.value == pytest.approx(taus_s[0] * taus_s[1], abs=3.0 * product_s2.std)
    motor = found.model["tau_motor_s"]
    assert motor.value == pytest.approx(taus_s[0], abs=3.0 * motor.std)
    assert found.load.fit > 0.9


def test_the_on_line_estimate_stands_beside_it(found: RecordLoad, session_path: Path) -> None:
    last = read_session(session_path).table("slow")["estimates"].to_pylist()[-1][0]
    assert found.online["gain"].value == last["value"]
    text = as_text(found)
    assert f"{last['value']:.5g}" in text
    assert "[load.model]  # proposed\ngain = 0.01" in text
    assert as_json(found)["model"]["gain"].std == found.load.parameters["gain"].std


def test_a_session_with_missed_ticks_is_identified(tmp_path: Path, session_path: Path) -> None:
    """Parts that the gaps leave too short are left out and counted."""
    kept = [n for n in range(50 * 120) if n < 3600 or n % 400 < 60 + n // 100]
    ticks, slow = lived((0.0113, 40.0, 300.7))
    text = read_session(session_path).config_text
    directory = create_session(tmp_path, INFO, text)
    batch = make_batch([ticks[n] for n in kept if n < len(ticks)], slow, last=True)
    record_messages(directory, Header(INFO, text), batch)
    found, stretches = identify_session(read_session(directory))
    assert found.load.parameters["gain"].value == pytest.approx(0.0113, rel=0.05)
    assert found.left_out > 0
    assert len(stretches) == len(found.load.residuals)
    assert f"{found.left_out} parts of too few samples left out" in as_text(found)


def test_a_part_in_which_nothing_ran_is_refused(session_path: Path) -> None:
    with pytest.raises(IdentificationError, match="did not run"):
        identify_session(read_session(session_path), 1000.0)


def test_a_line_whose_frequency_wanders_has_one_period(tmp_path: Path) -> None:
    """From one run of the drive to the next, by more than excerpts of one experiment may differ."""
    ticks = [make_tick(number) for number in range(600)]
    slower = [
        replace(one, measurement=replace(one.measurement, tick_period_s=1.003 / 120.0))
        for one in map(make_tick, range(2000, 2600))
    ]
    directory = create_session(tmp_path, INFO, "")
    record_messages(directory, Header(INFO, ""), make_batch([*ticks, *slower], last=True))
    stretches, _ = read_stretches(read_session(directory))
    assert len(stretches) == 2
    for one in stretches:
        assert one.period_s == pytest.approx(1.0015 / 120.0)
