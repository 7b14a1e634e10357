"""`adaptdrive run`, which imports nothing but what the daemon needs."""

import gc
import os
import threading
import time
from pathlib import Path

_THREAD_PATIENCE_S = 0.5


def run(config: Path, /) -> int:
    """Run the daemon for one drive until a signal stops it.

    Args:
        config: Configuration file.

    Returns:
        Exit status.
    """
    gc.disable()  # a fifth of the start would go to looking through what imports make, which stays
    from adaptdrive.app.run import run as run_drive  # noqa: PLC0415 - see above

    gc.freeze()  # without this the next collection would look through all of it
    gc.enable()
    status = run_drive(config)
    _leave_stuck_threads(status)
    return status


def _leave_stuck_threads(status: int) -> None:
    """End the process at once while a thread waits for the disk, which would hold up its end."""
    deadline_s = time.monotonic() + _THREAD_PATIENCE_S
    others = [one for one in threading.enumerate() if one is not threading.current_thread()]
    for thread in others:
        if not thread.daemon:
            thread.join(max(0.0, deadline_s - time.monotonic()))
            if thread.is_alive():
                os._exit(status)
