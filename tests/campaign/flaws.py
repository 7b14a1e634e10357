"""The message about a file of a campaign with one line changed."""

from __future__ import annotations

from pathlib import Path

import pytest

from adaptdrive.errors import ConfigurationError
from adaptdrive_sim.campaign.main import read_any_campaign


def message_about(path: Path, text: str, old: str, new: str) -> str:
    """Return the message of the error that follows from a change of a file.

    Args:
        path: Where to write the changed file.
        text: Contents of a file without errors.
        old: What is replaced; must be in the text.
        new: What replaces it.
    """
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(ConfigurationError) as problem:
        read_any_campaign(path)
    return str(problem.value)
