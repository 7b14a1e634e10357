"""Adaptive control of a load behind a power-electronic drive.

A wheel may hold compiled modules next to their sources. `ADAPTDRIVE_PURE=1` in the environment
imports the sources.
"""

import os
import sys
from importlib.machinery import SOURCE_SUFFIXES, FileFinder, SourceFileLoader
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from importlib.abc import PathEntryFinder

__version__ = "0.1.0"


def import_sources(folder: str) -> None:
    """Import the sources of a package from now on, also those that are compiled.

    Args:
        folder: Folder of the package.
    """
    hook = FileFinder.path_hook((SourceFileLoader, SOURCE_SUFFIXES))

    def ours(path: str) -> "PathEntryFinder":
        if path != folder and not path.startswith(f"{folder}/"):
            raise ImportError(f"{path} is not in this package", path=path)
        return hook(path)

    sys.path_hooks.insert(0, ours)
    sys.path_importer_cache.clear()


def build_name() -> str:
    """Return "compiled" where the controller's modules are compiled, else "pure Python"."""
    from adaptdrive.control import controller  # noqa: PLC0415 - the choice comes before it

    return "pure Python" if str(controller.__file__).endswith(".py") else "compiled"


if os.environ.get("ADAPTDRIVE_PURE", "0") != "0":
    import_sources(__path__[0])
