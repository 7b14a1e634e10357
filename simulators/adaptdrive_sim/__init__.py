"""Simulated drives, loads and buses for adaptdrive.

`ADAPTDRIVE_PURE=1` in the environment imports the sources of compiled modules, as in `adaptdrive`.
"""

import os as _os

if _os.environ.get("ADAPTDRIVE_PURE", "0") != "0":
    from adaptdrive import pure as _pure

    _pure.import_sources(__path__[0])
