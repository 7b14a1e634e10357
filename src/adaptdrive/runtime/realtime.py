"""The real-time set-up: what is asked of the kernel, what it grants, and what that means.

Everything here is optional. An ordinary user is refused most of it and gets a daemon that works,
only with ticks that other processes can delay.
"""

import ctypes
import errno
import gc
import os
import resource
import struct
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from adaptdrive.config.services import Realtime

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_CAP_IPC_LOCK = 14
_CPU_LATENCY = Path("/dev/cpu_dma_latency")
_PYTHONS_SWITCH_S = 5e-3
"""Default of `sys.setswitchinterval`."""
_SWITCH_S = 2e-4  # another thread of the process keeps a tick waiting no longer than this


@dataclass(frozen=True, slots=True)
class Grant:
    """One real-time setting that the configuration requests.

    Attributes:
        asked: What, in the words of the configuration.
        granted: Whether it is in force.
        meaning: What follows from that, in one sentence.
    """

    asked: str
    granted: bool
    meaning: str


@contextmanager
def real_time(settings: Realtime) -> Iterator[list[Grant]]:
    """Ask for everything that is wanted; a refusal is an answer and no error.

    Enter it in the thread that runs the event loop, when everything is loaded and warmed up. At its
    end threads, garbage and idle CPUs are Python's and the kernel's again; the priority stays.
    """
    with ExitStack() as held:
        held.callback(_thaw)
        sys.setswitchinterval(_SWITCH_S)
        _freeze()
        yield list(_asked(settings, held))


def helper_thread(priority: int | None) -> Callable[[], None]:
    """Return the function that a helper thread of the process must call first.

    Python runs one thread at a time. An ordinary thread that has Python's lock may be kept from
    running by any busy process, and with it the ticks, which wait for the lock. Helpers therefore
    run right below the ticks.

    Args:
        priority: That of the ticks, None for ordinary scheduling.
    """

    def start() -> None:
        if priority is not None:
            with suppress(PermissionError):  # the refusal was reported for the ticks
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(max(1, priority - 1)))

    return start


def _asked(settings: Realtime, held: ExitStack) -> Iterator[Grant]:
    if settings.cpu_latency_us is not None:
        yield _keep_awake(settings.cpu_latency_us, held)
    if settings.priority is not None:
        yield _lock_memory()
        yield _schedule(settings.priority)


def _attempt(asked: str, do: Callable[[], object], granted: str, refused: str) -> Grant:
    try:
        do()
    except OSError as problem:
        reason = os.strerror(problem.errno) if problem.errno else str(problem)
        return Grant(asked, granted=False, meaning=f"{reason}: {refused}")
    return Grant(asked, granted=True, meaning=granted)


def _schedule(priority: int) -> Grant:
    """Schedule this thread in real time; threads that it starts have ordinary priority."""
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    return _attempt(
        f"priority = {priority}",
        lambda: os.sched_setscheduler(0, policy, os.sched_param(priority)),
        "ordinary processes cannot delay a tick",
        "any busy process can delay a tick; grant CAP_SYS_NICE or LimitRTPRIO",
    )


def _keep_awake(latency_us: int, held: ExitStack) -> Grant:
    """The kernel's quality of service for idle CPUs: it lasts as long as its file stays open."""
    wanted = struct.pack("i", latency_us)
    return _attempt(
        f"cpu_latency_us = {latency_us}",
        lambda: held.enter_context(_CPU_LATENCY.open("wb", buffering=0)).write(wanted),
        "all CPUs of this machine sleep less deeply, and draw more power",
        f"an idle CPU takes its time to wake up; grant writing to {_CPU_LATENCY}",
    )


def _lock_memory() -> Grant:
    """Lock pages as they are touched; locking all at once would make untouched ones resident."""

    def do() -> None:
        if not may_lock_memory():
            raise OSError(errno.EPERM, "")
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) != 0:
            raise OSError(ctypes.get_errno(), "")

    return _attempt(
        "memory in RAM",
        do,
        "no page of the daemon is ever swapped out",
        "a tick can wait for the disk while memory is short; grant CAP_IPC_LOCK or "
        "LimitMEMLOCK=infinity",
    )


def may_lock_memory() -> bool:
    """Return whether memory may be locked without limit.

    A finite limit is worse than none: later allocations would fail at it.
    """
    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    return soft == resource.RLIM_INFINITY or bool(_capabilities() >> _CAP_IPC_LOCK & 1)


def _capabilities() -> int:
    for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines():
        if line.startswith("CapEff:"):
            return int(line.split()[1], base=16)
    return 0


def _freeze() -> None:
    """Exempt what is loaded from collections; what is new is collected after ticks."""
    gc.collect()
    gc.freeze()
    gc.disable()


def _thaw() -> None:
    gc.enable()
    gc.unfreeze()
    sys.setswitchinterval(_PYTHONS_SWITCH_S)
