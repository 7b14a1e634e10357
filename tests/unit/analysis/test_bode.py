"""The drawn loop: its margins, and the band that the covariance of the load spreads."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from adaptdrive import lab
from adaptdrive.analysis.bode import BAND, as_text, curves_of, draw_loop, spread_of
from adaptdrive.cli import main
from tests.unit.app.test_replay import EXAMPLE


def test_a_gain_that_is_uncertain_moves_the_magnitude_alone() -> None:
    """Its band is known in closed form: 1.96 deviations of the gain, in dB, at each frequency."""
    model = lab.model(EXAMPLE)
    covariance = np.zeros((3, 3))
    covariance[0, 0] = (0.05 * model.parameters["gain"].value) ** 2
    drawn = list(replace(model, covariance=covariance).drawn())
    omega = np.geomspace(0.001, 1.0, 50) * np.pi / model.period_s
    moved = np.array([curves_of(one, omega) for one in drawn]) - curves_of(model, omega)
    ends = 20.0 * np.log10([1.0 - 1.96 * 0.05, 1.0 + 1.96 * 0.05])
    for at, expected in zip(np.percentile(moved, BAND, axis=0), ends, strict=True):
        assert at[0] == pytest.approx(expected, abs=0.2)
        assert at[1] == pytest.approx(0.0, abs=1e-6)
    found = spread_of(model, drawn)
    low, high = found.bands["gain"]
    assert low == pytest.approx(found.margins.gain / 1.098, rel=0.03)
    assert high == pytest.approx(found.margins.gain / 0.902, rel=0.03)
    assert found.stable == found.loads == 200


def test_the_band_lies_about_the_response_of_the_model(session_path: Path) -> None:
    model = lab.model(session_path)
    drawn, omega = list(model.drawn()), np.geomspace(0.001, 1.0, 50) * np.pi / model.period_s
    low, high = np.percentile([curves_of(one, omega) for one in drawn], BAND, axis=0)
    assert np.all(low <= curves_of(model, omega) + 1e-9)
    assert np.all(curves_of(model, omega) <= high + 1e-9)
    assert as_text(model, spread_of(model, drawn)).count(" to ") == 3
    assert draw_loop(model, drawn, model.margins) != draw_loop(model, [], model.margins)


def test_loads_that_the_controller_does_not_hold_are_counted() -> None:
    model = lab.model(EXAMPLE)
    deviations = [one.value for one in model.parameters.values()]
    uncertain = replace(model, covariance=np.diag(np.square(deviations)))
    found = spread_of(model, list(uncertain.drawn()))
    assert 0 < found.stable < found.loads
    heavier = model.around(np.array([4.0 * deviations[0], *deviations[1:]]))
    assert heavier.load.gain == pytest.approx(4.0 * model.load.gain)


def test_plot_draws_the_open_loop(
    session_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["plot", str(session_path), "--bode", "--into", str(tmp_path)]
    assert main(words) == 0
    said = capsys.readouterr().out
    margins = lab.model(session_path).margins
    assert re.search(rf"gain margin   {margins.gain:.3g} \(\d.*rad/s", said)
    assert f"delay margin  {margins.delay_s:.3g} s (" in said
    assert (tmp_path / "bode.png").read_bytes()[:4] == b"\x89PNG"
    assert not (tmp_path / "figure.png").exists()
    assert main([*words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["margins"]["phase_deg"] == pytest.approx(margins.phase_deg)
    assert found["loads"] == 200
    assert found["bands"]["gain"][0] < found["margins"]["gain"] < found["bands"]["gain"][1]
