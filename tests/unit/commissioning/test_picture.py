"""The live picture of an experiment, drawn by rich at the size of a small terminal."""

from __future__ import annotations

import io

from rich.console import Console

from adaptdrive.commissioning.client import FastReading
from adaptdrive.commissioning.course import ExperimentCourse
from adaptdrive.commissioning.experiment import load_experiment
from adaptdrive.commissioning.run import screen, take_point
from adaptdrive.tui.record import WatchRecord
from tests.unit.commissioning.test_experiment import SAMPLE_S, TARGET, lag


def run(record: WatchRecord, experiment: ExperimentCourse, samples: int) -> None:
    """Feed an experiment and its picture with samples of a load."""
    load, voltage_V = lag(0.01, 2.0, noise=0.002), 200.0
    for number in range(1, samples + 1):
        reading = FastReading(number * SAMPLE_S, voltage_V, load(voltage_V), 0.0, bridge=True)
        voltage_V = experiment.take(reading.time_s, reading.boost_voltage_V, reading.output)
        take_point(record, experiment, reading)
        if experiment.done:
            break


def test_it_shows_phase_voltage_output_and_the_key_that_ends_it() -> None:
    record, experiment = WatchRecord("motor", lambda: 0.0), load_experiment(TARGET)
    run(record, experiment, 600)
    file = io.StringIO()
    Console(file=file, width=80, height=24).print(screen(record, experiment, (80, 24)))
    text = file.getvalue()
    assert " motor  switching the voltage" in text
    assert f"V_c {experiment.voltage_V:.0f} V" in text
    assert "speed 2." in text
    assert "▼climb" in text
    assert "▼test" in text
    assert "q ends the experiment with the drive off" in text
    assert max(len(line) for line in text.splitlines()) <= 80
