from __future__ import annotations

from pathlib import Path

import pytest

from adaptdrive.errors import ConfigurationError
from adaptdrive_sim.campaign.main import read_any_campaign
from adaptdrive_sim.campaign.settings import FOLDER, read_campaign
from tests.campaign.flaws import message_about

STANDARD = (FOLDER / "standard.toml").read_text(encoding="utf-8")


def test_the_campaign_that_comes_along_covers_what_it_promises() -> None:
    campaign = read_campaign(Path("campaign/standard.toml"))
    assert campaign.runs == 2000
    assert campaign.load.inertia == (1.0, 4.0)
    assert campaign.load.unchanged >= 0.3
    assert campaign.wire.output_delay_ticks == (0, 2)


@pytest.mark.parametrize(
    ("old", "new", "flaw"),
    [
        ("runs = 2000", "runs = 0", "runs = 0: "),
        ("inertia = [1.0, 4.0]", "inertia = [4.0, 1.0]", "load.inertia = [4.0, 1.0]: "),
        ("sigma = [0.0, 0.02]", 'sigma = "much"', "noise.sigma = 'much': "),
        ("seed = 1 ", "seeds = 1 ", "seeds: Extra inputs are not permitted"),
        ("frequency_Hz = [59.9, 60.1]", "", "line.frequency_Hz: Field required"),
        ('"sine"]', '"saw"]', "reference.shapes.4 = 'saw': "),
    ],
)
def test_an_error_names_key_and_value(tmp_path: Path, old: str, new: str, flaw: str) -> None:
    path = tmp_path / "mine.toml"
    assert f"{path}: {flaw}" in message_about(path, STANDARD, old, new)


@pytest.mark.parametrize("named", [b"", b'type = "bath"\n', b'type = "battery"\n'])
def test_a_file_that_is_not_utf_8_is_one_error(tmp_path: Path, named: bytes) -> None:
    path = tmp_path / "mine.toml"
    path.write_bytes(named + b"# 20 \xb0C\n")
    with pytest.raises(ConfigurationError) as problem:
        read_any_campaign(path)
    place = len(named) + 5
    assert str(problem.value).startswith(f"{path}: ")
    assert str(problem.value).endswith(f"in position {place}: invalid start byte")


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"missing\.toml: .*No such file"):
        read_campaign(tmp_path / "missing.toml")
