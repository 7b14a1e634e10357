"""What if: a recorded session again with other settings, against the simulated plant itself."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from adaptdrive.analysis.curves import quality_of
from adaptdrive.analysis.whatif import Comparison, as_text, what_if
from adaptdrive.control.signals import Mode
from adaptdrive.recording.records import Header
from adaptdrive.recording.session import create_session
from adaptdrive.runtime.reports import LoadReport, TickReport
from adaptdrive.util.errors import IdentificationError
from tests.integration.closed_loop.bench import STEP
from tests.unit.app.test_replay import EXAMPLE, PRIOR, lived
from tests.unit.recording.material import INFO, make_batch, record_messages

RATE = 120
"""Ticks in a second."""


@pytest.fixture(scope="module")
def stepped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three half-cycles of a square wave with three disks, unknown to the nominal model."""
    text = EXAMPLE.read_text(encoding="utf-8")
    info = msgspec.structs.replace(INFO, output_unit="V", prior=PRIOR)
    directory = create_session(tmp_path_factory.mktemp("sessions"), info, text)
    batch = make_batch(*lived(PRIOR, 180), last=True)
    record_messages(directory, Header(info, text), batch)
    return directory


@pytest.fixture(scope="module")
def slower(stepped: Path) -> Comparison:
    return what_if(stepped, ["load.pole=0.8"])


def test_the_loop_with_the_recorded_settings_repeats_the_record(slower: Comparison) -> None:
    recorded, repeated = slower.recorded, slower.repeated
    assert np.sqrt(np.mean((repeated.output - recorded.output) ** 2)) < 0.02 * STEP
    assert repeated.quality.error == pytest.approx(recorded.quality.error, rel=0.05)
    assert recorded.quality.steps == 2


def test_a_slower_pole_settles_later_with_less_effort(slower: Comparison) -> None:
    assert slower.changed.quality.settling_s > 1.2 * slower.repeated.quality.settling_s
    assert slower.changed.quality.effort_V < 0.8 * slower.repeated.quality.effort_V
    assert slower.idle == ()
    assert "settling to 5 %, median s" in as_text(slower)


def test_a_part_begins_with_what_the_controller_had_learnt(stepped: Path) -> None:
    found = what_if(stepped, [], 115.0)
    assert found.repeated.time_s[0] == pytest.approx(116.0, abs=1.0)
    np.testing.assert_allclose(found.repeated.output, found.recorded.output, atol=0.05 * STEP)
    assert found.repeated.quality.settling_s < 1.2 * found.recorded.quality.settling_s


def test_a_setting_that_acts_on_no_loop_is_named(stepped: Path) -> None:
    found = what_if(stepped, ["mqtt.port=1884", "load.pole=0.8"], None, 20.0)
    assert found.idle == ("mqtt.port=1884",)


def test_quality_is_that_of_a_known_response() -> None:
    """A second-order step: overshoot e^(-π ζ/√(1-ζ²)), settling by its own definition."""
    damping, time_s = 0.5, np.arange(0.0, 60.0, 0.1)
    ring = np.sqrt(1.0 - damping**2)
    wave = np.cos(ring * time_s) + damping / ring * np.sin(ring * time_s)
    response = 1.0 - np.exp(-damping * time_s) * wave
    lead = np.zeros(50)
    reference = np.concatenate((lead, np.ones(len(time_s))))
    output = np.concatenate((lead, response))
    found = quality_of(reference, output, 300.0 + output, 0.1, 1.0)
    assert found.overshoot == pytest.approx(np.exp(-np.pi * damping / ring), abs=1e-3)
    settled_s = time_s[np.flatnonzero(np.abs(response - 1.0) > 0.05)[-1] + 1]
    assert found.settling_s == pytest.approx(settled_s)
    assert (found.steps, found.unsettled) == (1, 0)


def by_hand(ticks: list[TickReport]) -> list[TickReport]:
    return [
        replace(one, order=replace(one.order, mode=Mode.MANUAL, manual_V=300.0)) for one in ticks
    ]


def recorded(folder: Path, ticks: list[TickReport], slow: list[LoadReport]) -> Path:
    text = EXAMPLE.read_text(encoding="utf-8")
    directory = create_session(folder, INFO, text)
    record_messages(directory, Header(INFO, text), make_batch(ticks, slow, last=True))
    return directory


@pytest.mark.proof
def test_a_longer_part_set_by_hand_is_not_the_loop(tmp_path: Path) -> None:
    ticks, slow = lived(PRIOR, 260)
    found = what_if(
        recorded(tmp_path, [*ticks[: 100 * RATE], *by_hand(ticks[110 * RATE :])], slow), []
    )
    assert found.recorded.time_s[-1] <= 100.0
    assert "of the session, its longest part" in as_text(found)


def test_a_session_that_a_hand_alone_has_set_has_no_loop_to_compare(tmp_path: Path) -> None:
    ticks, slow = lived(PRIOR, 60)
    with pytest.raises(IdentificationError, match="no controller was in force"):
        what_if(recorded(tmp_path, by_hand(ticks), slow), ["load.pole=0.8"])
