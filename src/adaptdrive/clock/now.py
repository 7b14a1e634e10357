"""The clock of the daemon: nobody sets it, and it counts the time that the machine is suspended."""

import time
from collections.abc import Callable
from functools import partial
from typing import Final

CLOCK: Final = time.CLOCK_BOOTTIME
"""CLOCK_MONOTONIC stands still while the machine is suspended: a measurement from before would look
fresh afterwards, and nothing would tell that the daemon did not run."""

now_s: Final[Callable[[], float]] = partial(time.clock_gettime, CLOCK)
"""Return the time since the start of the machine, in s."""
