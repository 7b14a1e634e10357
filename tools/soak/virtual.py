"""Days of one drive in virtual time, in which everything that is measured must stay flat."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from tools.soak.life import Life
from tools.soak.meters import HEAD, Meter, of_this

SAMPLE_s = 300.0
"""Virtual time between two samples."""

MEMORY = Path("/dev/shm")
DAY_s = 86400.0


def soak(days: float, seed: int, minutes: float) -> tuple[list[str], bool]:
    """Live for some days.

    Args:
        days: Virtual time.
        seed: Of all that happens.
        minutes: Longest real time; what was done until then is judged.

    Returns:
        Lines of a report, and whether all of it is as it should be.
    """
    meter = Meter("daemon, drive and recorder", of_this)
    place = MEMORY if MEMORY.is_dir() else None
    with TemporaryDirectory(dir=place) as folder:
        life = Life(seed, Path(folder) / "session")
        began_s, cpu_s = life.daemon.now, time.process_time()
        ends_s = time.monotonic() + 60.0 * minutes
        while life.daemon.now - began_s < days * DAY_s and time.monotonic() < ends_s:
            life.pass_time(SAMPLE_s)
            passed_s = life.daemon.now - began_s
            meter.look(passed_s / 3600.0)
            sys.stderr.write(f"{passed_s / DAY_s:.3f} days, {time.process_time() - cpu_s:.0f} s\n")
        life.close()
    flaws = [flaw for one in life.sessions for flaw in one.flaws]
    lines = [*_told(life, passed_s, days, seed), *flaws, "", *HEAD, *meter.lines()]
    return lines, not flaws and all(one.flat for one in meter.trends().values())


def _told(life: Life, passed_s: float, days: float, seed: int) -> Iterator[str]:
    """Yield what was done, in words."""
    sessions = life.sessions
    ticks = sum(one.ticks for one in sessions)
    exact = sum(not one.flaws for one in sessions)
    yield (
        f"{passed_s / DAY_s:.2f} of {days:g} days of a motor on CAN, seed {seed}: "
        f"{life.counts.pop('half cycles'):,} half cycles; {len(sessions)} sessions with {ticks:,} "
        f"ticks, {sum(one.slow_steps for one in sessions):,} slow steps and "
        f"{sum(one.events for one in sessions):,} events; {exact} sessions bit-equal and whole. "
        "No command energised the drive while it had to be off."
    )
    yield ""
    yield ", ".join(f"{count:,} × {name}" for name, count in sorted(life.counts.items())) + "."
