"""Nothing begins unasked; proposed settings go only into a configuration valid at that moment."""

from __future__ import annotations

import io
import math
import os
import resource
import shutil
import stat
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from adaptdrive.analysis.curves import Quality, Response
from adaptdrive.app.examine import examine_text
from adaptdrive.cli import main
from adaptdrive.commissioning.evaluation import Commissioned, refusal_of, write
from adaptdrive.commissioning.proposal import refuse_unwritable, with_values, write_values
from adaptdrive.commissioning.run import alone
from adaptdrive.mqtt.connection import Broker
from adaptdrive.util.errors import AdaptdriveError, CommissionError, ConfigurationError

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"


class Terminal(io.StringIO):
    """Input that somebody types."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("typed", ["", "\n", "n\n"], ids=["Ctrl-D", "Enter", "no"])
def test_without_a_yes_nothing_begins(
    typed: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdin", Terminal(typed))
    assert main(["commission", "motor", "--config", str(EXAMPLES / "motor.toml")]) == 1
    said = capsys.readouterr()
    assert "is enabled in mode manual" in said.out
    assert said.out.endswith("begin? [y/N] " if typed else "begin? [y/N] \n")
    assert said.err == ""


def test_a_second_experiment_on_a_drive_is_refused() -> None:
    broker = Broker(host="bench.example")
    with (
        alone("commissioned", broker),
        alone("another", broker),
        alone("commissioned", Broker(host="elsewhere.example")),
        pytest.raises(AdaptdriveError, match=rf"commissioned by process {os.getpid()}"),
        alone("commissioned", broker),
    ):
        pytest.fail("it began")
    with alone("commissioned", broker):
        pass


def test_a_file_that_the_settings_no_longer_suit_is_left_as_it_is(tmp_path: Path) -> None:
    file = tmp_path / "motor.toml"
    shutil.copy(EXAMPLES / "adaptdrive.dbc", tmp_path)
    shutil.copy(EXAMPLES / "motor.toml", file)
    before = file.read_bytes()
    proposal = SimpleNamespace(values={"load.pole": 1.5})
    with pytest.raises(ConfigurationError, match="pole"):
        write(file, cast("Commissioned", SimpleNamespace(proposal=proposal, refusal="")))
    assert file.read_bytes() == before
    assert not file.with_name("motor.toml.bak").exists()


def foreseen(overshoot: float, settling_s: float = 9.0, fault: str = "") -> Response:
    quality = Quality(1, overshoot, settling_s, 0, 0.1, 1.0, 40.0)
    none = np.zeros(1)
    return Response(none, none, none, none, quality, fault)


@pytest.mark.parametrize(
    ("proposed", "present", "why"),
    [
        (foreseen(61.2, math.nan), foreseen(0.1), "does not settle: .* 6120.0 %, settling nan s"),
        (foreseen(math.nan), foreseen(0.1), "does not settle: predicted overshoot nan %"),
        (foreseen(math.inf, math.inf), foreseen(0.1), "does not settle: predicted overshoot inf"),
        (foreseen(0.0, fault="cell too warm"), foreseen(0.1), "trips: cell too warm"),
        (foreseen(0.12), foreseen(0.03), "predicted overshoot 12.0 %, with the present .* 3.0 %"),
        (foreseen(0.12), foreseen(0.13), ""),
        (foreseen(0.12), foreseen(math.nan, math.nan), ""),
        (foreseen(0.009), foreseen(0.0), ""),
    ],
)
def test_a_prediction_that_is_no_good_writes_nothing(
    proposed: Response, present: Response, why: str
) -> None:
    refusal = refusal_of(proposed, present)
    assert bool(refusal) == bool(why)
    found = cast("Commissioned", SimpleNamespace(refusal=refusal))
    if why:
        with pytest.raises(CommissionError, match=f"motor.toml stays as it is: .*{why}"):
            write(Path("motor.toml"), found)


def test_a_full_disk_is_found_before_the_experiment(tmp_path: Path) -> None:
    file = tmp_path / "motor.toml"
    file.write_text("name = 1\n", encoding="utf-8")
    refuse_unwritable(file)
    usual = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, usual[1]))
    try:
        with pytest.raises(ConfigurationError, match="cannot be written"):
            refuse_unwritable(file)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)
    assert [one.name for one in tmp_path.iterdir()] == ["motor.toml"]
    assert file.read_text(encoding="utf-8") == "name = 1\n"


def test_tables_that_are_too_scattered_are_refused_before_the_experiment(tmp_path: Path) -> None:
    file = tmp_path / "motor.toml"
    shutil.copy(EXAMPLES / "adaptdrive.dbc", tmp_path)
    text = (EXAMPLES / "motor.toml").read_text(encoding="utf-8")
    head, _, rest = text.partition("[bus.integrity.DriveCommand]")
    own, load, rest = rest.partition("[load]")
    inline = '[bus.integrity]\nDriveCommand = { counter = "CommandAlive" }\n'
    signals = own[own.index("[signals]") :]
    status = head[
        head.index("[bus.integrity.DriveStatus]") : head.index("[bus.integrity.DriveLoad]")
    ]
    file.write_text(head.replace(status, "") + inline + signals + load + rest + status, "utf-8")
    examine_text(file.read_text("utf-8"), file)  # the daemon takes it
    with pytest.raises(ConfigurationError, match=r"motor\.toml: file: cannot be changed: .*line"):
        refuse_unwritable(file)


def test_a_comment_on_a_value_that_changes_goes_and_every_other_one_stays() -> None:
    path = EXAMPLES / "motor.toml"
    old = path.read_text(encoding="utf-8")
    new = with_values(path, old, {"load.period_s": 0.2, "load.pole": 0.70})
    assert "period_s = 1.0                      # slow period: 120 ticks" in old
    (changed,) = set(new.splitlines()) - set(old.splitlines())
    assert changed == "period_s = 0.2 # by adaptdrive commission"


def test_the_file_keeps_its_owner_its_rights_and_the_link_to_it(tmp_path: Path) -> None:
    if os.getuid() != 0:
        pytest.skip("only root may give files away")
    file, link = tmp_path / "real.toml", tmp_path / "bench.toml"
    file.write_text("old", encoding="utf-8")
    file.chmod(0o640)
    os.chown(file, 12, 34)
    link.symlink_to(file)
    backup = write_values(link, "new")
    assert link.is_symlink()
    for one, text in ((file, "new"), (backup, "old")):
        found = one.stat()
        assert one.read_text(encoding="utf-8") == text
        assert (found.st_uid, found.st_gid, stat.S_IMODE(found.st_mode)) == (12, 34, 0o640)
    assert sorted(one.name for one in tmp_path.iterdir()) == sorted(
        [link.name, file.name, backup.name]
    )


def test_what_was_there_before_any_commissioning_is_still_there_after_the_third(
    tmp_path: Path,
) -> None:
    file = tmp_path / "motor.toml"
    file.write_text("by hand", encoding="utf-8")
    backups = [write_values(file, f"proposal {number}") for number in range(3)]
    assert [one.name for one in backups] == ["motor.toml.bak", "motor.toml.bak2", "motor.toml.bak3"]
    texts = [one.read_text(encoding="utf-8") for one in (*backups, file)]
    assert texts == ["by hand", "proposal 0", "proposal 1", "proposal 2"]
