"""Adaptive control of a load behind a power-electronic drive.

A wheel may hold compiled modules next to their sources. `ADAPTDRIVE_PURE=1` in the environment
imports the sources.
"""

import os as _os

if _os.environ.get("ADAPTDRIVE_PURE", "0") != "0":
    from adaptdrive import pure as _pure

    _pure.import_sources(__path__[0])

__version__ = "0.1.0"
