"""The live picture of an experiment, drawn by rich at the size of a small terminal."""

from __future__ import annotations

import io

from rich.console import Console

from adaptdrive.commissioning.client import FastReading
from adaptdrive.commissioning.experiment import LoadExperiment
from adaptdrive.commissioning.picture import Picture, screen
from tests.unit.commissioning.test_experiment import SAMPLE_S, TARGET, lag


def drawn(picture: Picture, width: int = 80, height: int = 24) -> str:
    """What a terminal shows."""
    file = io.StringIO()
    Console(file=file, width=width, height=height).print(screen(picture, (width, height)))
    return file.getvalue()


def run(picture: Picture, samples: int) -> None:
    """Feed an experiment and its picture with samples of a load."""
    experiment, load, voltage_V = picture.experiment, lag(0.01, 2.0, noise=0.002), 200.0
    for number in range(1, samples + 1):
        reading = FastReading(number * SAMPLE_S, voltage_V, load(voltage_V), 0.0, bridge=True)
        voltage_V = experiment.take(reading.time_s, reading.boost_voltage_V, reading.output)
        picture.take(reading)
        if experiment.done:
            break


def test_it_shows_phase_voltage_output_and_the_key_that_ends_it() -> None:
    picture = Picture("motor", LoadExperiment(TARGET))
    run(picture, 600)
    text = drawn(picture)
    assert " motor  switching the voltage" in text
    assert f"V_c {picture.experiment.course.voltage_V:.0f} V" in text
    assert "speed 2." in text
    assert "▼climb" in text
    assert "▼test" in text
    assert "q ends the experiment with the drive off" in text
    assert max(len(line) for line in text.splitlines()) <= 80
