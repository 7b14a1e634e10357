"""The example configurations that come with the simulator."""

import tomllib
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parent.parent / "examples"


def example_tables(name: str) -> dict[str, Any]:
    """The tables of one example configuration."""
    return tomllib.loads((FOLDER / name).read_text(encoding="utf-8"))
