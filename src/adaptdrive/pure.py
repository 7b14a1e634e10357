"""Choice between the compiled modules and their Python sources."""

import sys
from importlib.machinery import SOURCE_SUFFIXES, FileFinder, SourceFileLoader
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from importlib.abc import PathEntryFinder


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
