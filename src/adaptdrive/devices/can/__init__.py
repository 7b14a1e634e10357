"""CAN: buses, frames and their times for every protocol on CAN, and drives that a DBC describes.

python-can imports asammdf wherever it is installed, for a logger that no daemon uses, and with it
numpy and pyarrow: over 100 MB. The import of python-can below leaves asammdf out.
"""

import sys


def _import_without_asammdf() -> None:
    if {"can", "asammdf"} & sys.modules.keys():
        return
    hidden: dict[str, object] = sys.modules  # type: ignore[assignment]
    hidden["asammdf"] = None  # makes its import fail
    try:
        import can  # noqa: F401, PLC0415 - see above
    finally:
        del sys.modules["asammdf"]


_import_without_asammdf()
