"""The proposed settings go only into a configuration that is valid at that moment."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from adaptdrive.commission.file import write_values
from adaptdrive.commission.run import Commissioned, write
from adaptdrive.errors import ConfigurationError


def test_a_file_that_became_invalid_is_left_as_it_is(tmp_path: Path) -> None:
    file = tmp_path / "bench.toml"
    file.write_text("drive = {", encoding="utf-8")
    proposal = SimpleNamespace(values={"load.pole": 0.8})
    proposed = cast("Commissioned", SimpleNamespace(proposal=proposal))
    with pytest.raises(ConfigurationError, match="TOML"):
        write(file, proposed)
    assert [one.read_text(encoding="utf-8") for one in tmp_path.iterdir()] == ["drive = {"]


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
