"""The proposed settings go only into a configuration that is valid at that moment."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

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
