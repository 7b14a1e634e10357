"""Simulated drives, loads and buses for adaptdrive.

`ADAPTDRIVE_PURE=1` in the environment imports the sources of compiled modules, as in `adaptdrive`.
"""

import os

import adaptdrive

if os.environ.get("ADAPTDRIVE_PURE", "0") != "0":
    adaptdrive.import_sources(__path__[0])
