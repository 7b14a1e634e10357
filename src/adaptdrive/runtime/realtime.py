"""The real-time set-up: what is asked of the kernel, what it grants, and what that means.

Everything here is optional. An ordinary user is refused most of it and gets a daemon that works,
only with ticks that other processes can delay.
"""

from __future__ import annotations

import ctypes
import errno
import gc
import os
import resource
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_CAP_IPC_LOCK = 14
_PYTHONS_SWITCH_S = 5e-3
_SWITCH_S = 2e-4  # another thread of the process keeps a tick waiting no longer than this


@dataclass(frozen=True, slots=True)
class RealtimeSettings:
    """What to ask for.

    Attributes:
        priority: SCHED_FIFO priority, None for ordinary scheduling.
        cpus: CPUs to run on, all when empty.
        lock_memory: Whether to keep the process in RAM.
        freeze_gc: Whether to take garbage collection out of the ticks.
    """

    priority: int | None = None
    cpus: tuple[int, ...] = ()
    lock_memory: bool = False
    freeze_gc: bool = False


@dataclass(frozen=True, slots=True)
class Grant:
    """One thing that was asked for.

    Attributes:
        asked: What, in the words of the configuration.
        granted: Whether it is in force.
        meaning: What follows from that, in one sentence.
    """

    asked: str
    granted: bool
    meaning: str


def set_up(settings: RealtimeSettings) -> list[Grant]:
    """Ask for everything that is wanted; a refusal is an answer and no error.

    Call it in the thread that runs the event loop, when everything is loaded and warmed up.
    """
    sys.setswitchinterval(_SWITCH_S)
    return list(_asked(settings))


def _asked(settings: RealtimeSettings) -> Iterator[Grant]:
    if settings.cpus:
        yield _pin(settings.cpus)
    if settings.lock_memory:
        yield _lock_memory()
    if settings.freeze_gc:
        yield _freeze()
    if settings.priority is not None:
        yield _schedule(settings.priority)


def _attempt(asked: str, do: Callable[[], None], granted: str, refused: str) -> Grant:
    try:
        do()
    except OSError as problem:
        reason = os.strerror(problem.errno) if problem.errno else str(problem)
        return Grant(asked, granted=False, meaning=f"{reason}: {refused}")
    return Grant(asked, granted=True, meaning=granted)


def _schedule(priority: int) -> Grant:
    """Real-time scheduling of this thread; threads and processes it starts stay ordinary."""
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK

    def do() -> None:
        os.sched_setscheduler(0, policy, os.sched_param(priority))

    return _attempt(
        f"priority = {priority}",
        do,
        "ordinary processes cannot delay a tick",
        "any busy process can delay a tick; grant CAP_SYS_NICE or LimitRTPRIO",
    )


def _pin(cpus: tuple[int, ...]) -> Grant:
    return _attempt(
        f"cpus = {list(cpus)}",
        lambda: os.sched_setaffinity(0, cpus),
        "the daemon and its recorder stay on these CPUs",
        f"no such CPUs; the daemon runs on {sorted(os.sched_getaffinity(0))}",
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
        "lock_memory = true",
        do,
        "no page of the daemon is ever swapped out",
        "a tick can wait for the disk while memory is short; grant CAP_IPC_LOCK or "
        "LimitMEMLOCK=infinity",
    )


def may_lock_memory() -> bool:
    """Whether memory may be locked without limit.

    A finite limit is worse than none: later allocations would fail at it.
    """
    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    return soft == resource.RLIM_INFINITY or bool(_capabilities() >> _CAP_IPC_LOCK & 1)


def _capabilities() -> int:
    for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines():
        if line.startswith("CapEff:"):
            return int(line.split()[1], base=16)
    return 0


def _freeze() -> Grant:
    gc.collect()
    gc.freeze()
    gc.disable()
    meaning = f"{gc.get_freeze_count()} objects are exempt; what is new is collected after ticks"
    return Grant("freeze_gc = true", granted=True, meaning=meaning)


_MIDDLE_EVERY = 10
_FULL_EVERY = 6000


class IdleCollector:
    """Collects garbage in the slack after a tick, in place of Python's own bad moments.

    While a drive runs, only young objects are looked at: a full collection takes as long as
    everything that lives is large, ten milliseconds and more with many commands remembered. It
    waits until the drive is off.
    """

    def __init__(self, every_ticks: int) -> None:
        """Collect nothing yet.

        Args:
            every_ticks: Ticks from one collection to the next; 0 for never.
        """
        self._every = every_ticks
        self._waited = 0
        self._collections = 0
        self._since_full = 0

    def is_due(self) -> bool:
        """Count a tick; whether a collection is due after it."""
        self._waited += 1
        if not self._every or self._waited < self._every:
            return False
        self._waited = 0
        return True

    def collect(self, *, idle: bool) -> int:
        """Collect what became garbage since the freeze.

        Args:
            idle: Whether the drive is off, so that a late tick does no harm.

        Returns:
            The generation that was collected.
        """
        self._collections += 1
        self._since_full += 1
        generation = 0 if self._collections % _MIDDLE_EVERY else 1
        if idle and self._since_full >= _FULL_EVERY:
            self._since_full, generation = 0, 2
        gc.collect(generation)
        return generation


def thaw() -> None:
    """Give threads and garbage back to Python, for what goes on after a daemon."""
    gc.enable()
    gc.unfreeze()
    sys.setswitchinterval(_PYTHONS_SWITCH_S)
