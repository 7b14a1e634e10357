"""The shortest form of the comparison with the controllers that a user would otherwise choose."""

from __future__ import annotations

import pytest

from adaptdrive.control.signals import Mode
from tools.benchmarks.rivals.cases import CASES
from tools.benchmarks.rivals.held import run_held
from tools.benchmarks.rivals.results import PAGE, ROOT, number, read, rendered
from tools.benchmarks.rivals.runs import CONTROLLERS, figures, takes_part

SEED = 44_900_000


@pytest.mark.proof
def test_a_rival_meets_the_plant_that_the_daemon_meets() -> None:
    stand = CASES["I"].stand(SEED)
    expected = stand.run(Mode.ADAPTIVE)
    voltages = expected["boost_reference_V"].tolist()
    course = stand.course(Mode.ADAPTIVE)
    found = run_held(stand.site(), course, lambda k, _output, _applied: voltages[k])
    for name in ("output", "measured", "boost_reference_V", "applied_V"):
        assert found[name].tolist() == expected[name].tolist()


@pytest.mark.proof
@pytest.mark.parametrize("rival", ["fixed", "SIMC PI", "relay PID"])
def test_with_three_disks_adaptive_follows_better(rival: str) -> None:
    assert figures(CASES["B"], SEED, "adaptive").rms < 0.25 * figures(CASES["B"], SEED, rival).rms


@pytest.mark.proof
@pytest.mark.parametrize("name", ["A", "B"])
def test_adaptive_comes_near_to_a_controller_that_knows_load_and_limits(name: str) -> None:
    known, adaptive = (figures(CASES[name], SEED, one).rms for one in ("MPC", "adaptive"))
    assert adaptive < known + 2.0


def test_the_page_shows_the_figures_of_the_result_file() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert rendered(text, read()) == text, "make rivals writes the page"


def test_the_readme_states_the_figures_of_three_disks() -> None:
    case = read()["cases"]["B"]
    rms = {name: number(case[name]["rms"][0]) for name in case}
    stated = (
        f"adaptive {rms['adaptive']} and fixed {rms['fixed']}, PI {rms['SIMC PI']}, "
        f"PID {rms['relay PID']}, recursive least squares with pole placement {rms['RLS']}, "
        f"an MPC that knows the true load {rms['MPC']}."
    )
    assert stated in " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())


def test_every_case_has_figures_of_every_controller() -> None:
    for name in CASES:
        assert set(read()["cases"][name]) == {c for c in CONTROLLERS if takes_part(c, name)}
