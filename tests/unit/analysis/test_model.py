"""The model of a load and its loop against python-control, scipy and the loop itself."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter
from scipy.stats import nbinom

from adaptdrive import lab
from adaptdrive.analysis.model import Model, Part, as_matlab, loop_margins, model_of_estimates
from adaptdrive.analysis.record import identify_session
from adaptdrive.cli import main
from adaptdrive.config import load_configuration
from adaptdrive.control.design.pole_placement import Plant, reference_lead
from adaptdrive.control.loads.discretise import held_model
from adaptdrive.control.signals import Estimate
from adaptdrive.recording.reader import read_session
from adaptdrive.util.errors import IdentificationError
from tests.unit.app.test_replay import EXAMPLE

needs_control = pytest.mark.skipif(
    find_spec("control") is None, reason="python-control is not installed"
)


@pytest.fixture(params=["motor", "bath", "battery"])
def model(request: pytest.FixtureRequest) -> Model:
    return lab.model(EXAMPLE.with_name(f"{request.param}.toml"))


@pytest.fixture(scope="module")
def of_session(session_path: Path) -> Model:
    return lab.model(session_path)


def largest_pole(model: Model, factor: complex) -> float:
    numerator, denominator = model.polynomials("loop")
    return float(np.abs(np.roots(np.polyadd(denominator, factor * numerator))).max())


def test_at_its_gain_margin_the_closed_loop_becomes_unstable(model: Model) -> None:
    """Also where the crossing is at half the sampling rate, as that of a battery."""
    assert largest_pole(model, 1.0) < 1.0
    assert largest_pole(model, 0.999 * model.margins.gain) < 1.0 + 1e-9
    assert largest_pole(model, 1.001 * model.margins.gain) > 1.0


def test_at_its_phase_margin_the_closed_loop_becomes_unstable(model: Model) -> None:
    """A constant phase has a complex factor; the loop is then no real one, and as stable."""
    lag = math.radians(model.margins.phase_deg)
    assert largest_pole(model, np.exp(-0.999j * lag)) < 1.0
    assert largest_pole(model, np.exp(-1.001j * lag)) > 1.0


def test_at_its_delay_margin_the_loop_passes_through_minus_one(model: Model) -> None:
    margins = model.margins
    omega = np.linspace(0.2, 5.0, 400_001) * margins.phase_rad_per_s
    omega = omega[omega < math.pi / model.period_s]
    late = model.response(omega) * np.exp(-1j * omega * margins.delay_s)
    assert np.abs(1.0 + late).min() < 1e-4


@needs_control
@pytest.mark.parametrize("gain", [0.08, 0.4, 1.3])
@pytest.mark.parametrize("other", [0.3, 0.7])
def test_margins_are_those_of_python_control(gain: float, other: float) -> None:
    import control  # noqa: PLC0415 - not installed everywhere

    below = np.convolve(np.convolve([1.0, -1.0], [1.0, -0.9]), [1.0, -other])
    found = loop_margins(np.array([0.0, gain, 0.5 * gain]), below, 2.0)
    loop = control.tf([gain, 0.5 * gain, 0.0], below, 2.0)
    gains, phases_deg, _, _, at, _ = control.stability_margins(loop, returnall=True)
    assert found.phase_deg == pytest.approx(min(phases_deg % 360.0), rel=1e-6)
    assert found.delay_s == pytest.approx(min(np.radians(phases_deg % 360.0) / at), rel=1e-6)
    half = -1.0 / loop(-1.0).real  # it looks for no crossing at half the sampling rate
    beyond = [one for one in (*gains, half) if one > 1.0]
    assert found.gain == pytest.approx(min(beyond, default=math.inf), rel=1e-6)


@needs_control
def test_the_loop_of_a_motor_has_the_margins_of_python_control(of_session: Model) -> None:
    from control import margin  # noqa: PLC0415 - as above

    for one in (of_session, lab.model(EXAMPLE)):
        gain, phase_deg, gain_at, phase_at = margin(one.control("loop"))
        found = one.margins
        assert (found.gain, found.phase_deg) == pytest.approx((gain, phase_deg), rel=1e-6)
        assert (found.gain_rad_per_s, found.phase_rad_per_s) == pytest.approx((gain_at, phase_at))


@needs_control
@pytest.mark.parametrize("part", ["load", "sampled", "controller", "loop"])
def test_python_control_and_scipy_take_each_part(model: Model, part: Part) -> None:
    omega = np.geomspace(1e-4, 0.99, 50) * math.pi / model.period_s
    theirs = model.control(part)(
        1j * omega if part == "load" else np.exp(1j * omega * model.period_s)
    )
    at = omega if part == "load" else omega * model.period_s
    assert model.scipy(part).freqresp(at)[1] == pytest.approx(theirs, rel=1e-9)


def read_matlab(text: str, name: str) -> list[Any]:
    """Arguments of the call that makes a system, polynomials as arrays."""
    (call,) = re.findall(rf"^{name} = tf\((.*)\);\n{name}_ss = ss\({name}\);$", text, re.MULTILINE)
    words = re.findall(r"\[[^]]*\]|[^, ]+", call)
    return [np.array(one[1:-1].split(), float) if one[0] == "[" else one for one in words]


@pytest.mark.parametrize("part", ["load", "sampled", "controller", "loop"])
def test_the_text_for_matlab_has_the_response_of_each_part(model: Model, part: Part) -> None:
    name = {"load": "H", "sampled": "G", "controller": "C", "loop": "L"}[part]
    numerator, denominator, *time = read_matlab(as_matlab(model), name)
    omega = np.geomspace(1e-4, 0.99, 50) * math.pi / model.period_s
    at = omega if part == "load" else omega * model.period_s
    z = 1j * at if part == "load" else np.exp(1j * at)
    expected = model.scipy(part).freqresp(at)[1]
    assert np.polyval(numerator, z) / np.polyval(denominator, z) == pytest.approx(expected)
    if part == "loop":
        assert expected == pytest.approx(model.response(omega), rel=1e-9)
    assert time == (["'InputDelay'", "0.0"] if part == "load" else [repr(model.period_s)])


def test_export_writes_the_model(
    session_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], of_session: Model
) -> None:
    assert main(["export", str(session_path), "--model", "--into", str(tmp_path)]) == 0
    script = Path(capsys.readouterr().out.strip())
    assert script.stem.isidentifier()
    text = script.read_text(encoding="utf-8")
    late = replace(of_session, load=replace(of_session.load, delay_s=0.25))
    assert text == as_matlab(of_session)
    assert read_matlab(as_matlab(late), "H")[2:] == ["'InputDelay'", "0.25"]
    assert main(["export", str(session_path)]) == 2
    assert "--to or --model" in capsys.readouterr().err


def test_the_held_model_is_that_of_scipy(model: Model) -> None:
    """Without delay and window: what the design adds to the load are those."""
    numerator, denominator = model.polynomials("load")
    theirs = cont2discrete((numerator, denominator), model.period_s, "zoh")
    padded = [0.0] * (len(denominator) - len(numerator)) + numerator.tolist()
    a, b = held_model(padded, denominator.tolist(), model.period_s, 0.0, 0.0)
    assert a == pytest.approx(theirs[1], rel=1e-9)
    assert b == pytest.approx(theirs[0][0], rel=1e-9, abs=1e-12)


def test_the_model_of_a_session_is_its_identified_load_and_its_last_gains(
    session_path: Path, of_session: Model
) -> None:
    session = read_session(session_path)
    found, _ = identify_session(session)
    gains = session.table("slow")["gains"][-1].as_py()
    assert of_session.parameters == found.load.parameters
    assert of_session.polynomials("load")[1] == pytest.approx(found.load.denominator)
    assert [*of_session.r[1:], *of_session.s] == gains[:-1]
    assert sum(of_session.s) == pytest.approx(gains[-1])
    assert sum(of_session.r) == pytest.approx(0.0, abs=1e-9)
    assert of_session.is_stable


def test_drawn_loads_have_the_covariance_of_the_estimate(of_session: Model) -> None:
    loads = [one.load for one in of_session.drawn()]
    values = np.array([one.physical(list(one.numerator), list(one.denominator)) for one in loads])
    deviations = np.array([one.std for one in of_session.parameters.values()])
    assert values.std(axis=0) == pytest.approx(deviations, rel=0.2)
    mean = np.array([one.value for one in of_session.parameters.values()])
    assert np.abs(values.mean(axis=0) - mean).max() < 0.3 * deviations.max()
    assert not list(lab.model(EXAMPLE).drawn())


def test_a_loop_that_is_not_stable_has_no_margins() -> None:
    made = lab.model(EXAMPLE)
    unstable = replace(made, b=-made.b)
    assert not unstable.is_stable
    assert unstable.margins.gain == 1.0
    assert unstable.margins.delay_s == unstable.margins.phase_deg == 0.0


def test_the_model_of_published_estimates_has_their_load_and_gains() -> None:
    configuration = load_configuration(EXAMPLE)
    fixed = lab.model(configuration)
    known = {name: Estimate(one.value, 0.1) for name, one in fixed.parameters.items()}
    gains = [*fixed.r[1:], *fixed.s, sum(fixed.s)]
    found = model_of_estimates(configuration, known, gains)
    assert (*found.a, *found.b) == pytest.approx((*fixed.a, *fixed.b))
    assert np.array_equal(found.r, fixed.r)
    assert np.array_equal(found.s, fixed.s)
    assert np.sqrt(np.diag(found.covariance)) == pytest.approx([0.1] * 3)
    with pytest.raises(IdentificationError, match="no gain"):
        model_of_estimates(configuration, {}, gains)


def settling_periods(pole: float, count: int) -> int:
    """Slow periods until a step behind equal poles, one period late, is within 2 %.

    Its impulse response is the negative binomial distribution.
    """
    return 2 + int(np.flatnonzero(nbinom.sf(np.arange(1000), count, 1.0 - pole) > 0.02)[-1])


def settled(name: str, pole: float) -> int:
    """The same of the fixed controller's loop around the load of an example."""
    configuration = load_configuration(EXAMPLE.with_name(f"{name}.toml"))
    section = configuration.load.model_copy(update={"pole": pole})
    model = lab.model(configuration.model_copy(update={"load": section}))
    led = np.ones(1000)
    led[0] += reference_lead(model.settings, model.load)
    loop = Plant(list(model.a), list(model.b)).closed([*model.r[1:], *model.s])
    output = lfilter(sum(model.s) * np.array(model.b), loop, led)
    return 1 + int(np.flatnonzero(np.abs(output - 1.0) > 0.02)[-1])


def test_the_table_of_poles_has_their_settling_times() -> None:
    page = (EXAMPLE.parents[2] / "docs" / "own-drive.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (0\.\d+) \| (\d+) \| (\d+) \| (\d+) \|$", page, re.MULTILINE)
    assert len(rows) == 6
    for pole, *periods in rows:
        for count, shown in zip((1, 2, 4), periods, strict=True):
            assert int(shown) == settling_periods(float(pole), count)
        for name, shown in zip(("battery", "bath", "motor"), periods, strict=True):
            assert 0 <= settled(name, float(pole)) - int(shown) <= 1
