"""Files of campaigns: what comes along, and errors that name key and value."""

from __future__ import annotations

from pathlib import Path

import pytest

from adaptdrive.util.errors import ConfigurationError
from adaptdrive_sim.campaign import read_any_campaign
from adaptdrive_sim.campaign.settings import FOLDER, Campaign, LifeRanges, read_campaign


def test_the_campaigns_that_come_along_cover_what_they_promise() -> None:
    standard, wide = (read_campaign(Path(name)) for name in ("campaign/standard.toml", "wide.toml"))
    assert standard.runs == 2000
    assert standard.load.inertia == (1.0, 4.0)
    assert standard.load.unchanged >= 0.3
    assert standard.wire.output_delay_ticks == (0, 2)
    assert standard.life == wide.life == LifeRanges()
    assert isinstance(read_any_campaign(Path("standard.toml")), Campaign)


@pytest.mark.parametrize(
    ("name", "old", "new", "flaw"),
    [
        ("standard", "runs = 2000", "runs = 0", "runs = 0: "),
        ("standard", "inertia = [1.0, 4.0]", "inertia = [4.0, 1.0]", "load.inertia = [4.0, 1.0]: "),
        ("standard", "sigma = [0.0, 0.02]", 'sigma = "much"', "noise.sigma = 'much': "),
        ("standard", "seed = 1 ", "seeds = 1 ", "seeds: Extra inputs are not permitted"),
        ("standard", "frequency_Hz = [59.9, 60.1]", "", "line.frequency_Hz: Field required"),
        ("standard", '"sine"]', '"saw"]', "reference.shapes.4 = 'saw': "),
        ("life", "[0.0, 20.0]", "[0.0, 90.0]", "life.torque_V = [0.0, 90.0]: "),
        ("life", "torque_changes = [0, 12]", "torque_changes = [3, 1]", "life.torque_changes = "),
        ("life", "sudden = 0.6", "sudden = 1.5", "life.sudden = 1.5: "),
        ("life", "gain = [0.75, 1.35]", "gain = [0.6, 1.35]", "load.gain = 0.6: V_c holds"),
        ("life", "off_s = [3.0, 30.0]", "off_s = [0.0, 1.0]", "life.off_s = [0.0, 1.0]: "),
        ("bath", "[0.3, 1.8]", "[0.3, 90.0]", "water.volume_gal = [0.3, 90.0]: "),
        ("bath", "inflow = [0.8, 1.25]", "inflow = [0.3, 3.0]", "V_c holds no set-point"),
        ("bath", 'type = "bath"', 'type = "kettle"', "must be one of motor, bath, battery"),
        ("battery", "[12.0, 400.0]", "[5.0, 400.0]", "battery.full_V = [5.0, 400.0]: "),
        ("battery", "growth = [1.2, 2.0]", "growth = [0.5, 2.0]", "battery.growth = [0.5, 2.0]: "),
        ("battery", "aged = 0.5", "aged = 1.5", "battery.aged = 1.5: "),
    ],
)
def test_an_error_names_key_and_value(
    tmp_path: Path, name: str, old: str, new: str, flaw: str
) -> None:
    text = (FOLDER / f"{name}.toml").read_text(encoding="utf-8")
    path = tmp_path / "mine.toml"
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(ConfigurationError) as problem:
        read_any_campaign(path)
    assert str(problem.value).startswith(f"{path}: ")
    assert flaw in str(problem.value)


@pytest.mark.parametrize("named", [b"", b'type = "bath"\n'])
def test_a_file_that_is_not_utf_8_is_one_error(tmp_path: Path, named: bytes) -> None:
    path = tmp_path / "mine.toml"
    path.write_bytes(named + b"# 20 \xb0C\n")
    with pytest.raises(ConfigurationError) as problem:
        read_any_campaign(path)
    place = len(named) + 5
    assert str(problem.value).startswith(f"{path}: ")
    assert str(problem.value).endswith(f"in position {place}: invalid start byte")
