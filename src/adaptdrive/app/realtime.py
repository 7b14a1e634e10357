"""`[realtime]` at start: rehearse, request the settings, and report the kernel's answers."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from adaptdrive.app.ports import build_port
from adaptdrive.app.settings import realtime_settings
from adaptdrive.app.warm_up import Rehearsal
from adaptdrive.clock.now import now_s
from adaptdrive.config import Configuration
from adaptdrive.runtime.hub import Hub
from adaptdrive.runtime.realtime import Grant, real_time
from adaptdrive.runtime.reports import Event, Severity


def build_rehearsal(configuration: Configuration, path: Path) -> Rehearsal:
    """Return a rehearsal of a drive's ticks, on a separate port."""
    return Rehearsal(configuration, build_port(configuration, now_s, path))


@contextmanager
def prepared(configuration: Configuration, rehearsal: Rehearsal, hub: Hub) -> Iterator[None]:
    """Rehearse, ask for what is configured, and publish an event for each answer.

    Args:
        configuration: The drive.
        rehearsal: Of its ticks.
        hub: Where the events go.
    """
    grants: list[Grant] = []
    if configuration.realtime.warm_up:
        grants.append(_rehearse(rehearsal))
    grants.extend(before_frames(configuration))
    with real_time(realtime_settings(configuration)) as answers:
        for grant in (*grants, *answers):
            hub.publish(_event(grant))
        yield


def before_frames(configuration: Configuration) -> Iterator[Grant]:
    """Return the work to do before each frame of the drive, and its description.

    Args:
        configuration: The drive.
    """
    wanted, tick_us = configuration.realtime, 0.5e6 / configuration.drive.line_frequency_Hz
    polled = configuration.bus.ticks_per_reading > 1
    if wanted.rehearse_us > 0.0:
        meaning = "a tick on a made-up drive before each frame keeps the CPU's caches warm"
        if polled:
            meaning = "a drive that is polled answers, and its replies must not wait for it"
        yield Grant(f"rehearse_us = {wanted.rehearse_us:g}", granted=not polled, meaning=meaning)
    if wanted.spin_us > 0.0:
        before = "each deadline of the timer" if polled else "each frame and deadline"
        share = 100.0 * wanted.spin_us / tick_us
        meaning = f"busy before {before}, up to {share:.0f} % of a CPU"
        yield Grant(f"spin_us = {wanted.spin_us:g}", granted=True, meaning=meaning)


def _event(grant: Grant) -> Event:
    severity = Severity.INFO if grant.granted else Severity.WARNING
    answer = "granted" if grant.granted else "refused"
    return Event("realtime", severity, f"{grant.asked} {answer}: {grant.meaning}", -1)


def _rehearse(rehearsal: Rehearsal) -> Grant:
    began_s = time.monotonic()
    ticks = rehearsal.run()
    spent_ms = (time.monotonic() - began_s) * 1e3
    return Grant(
        "warm_up = true", granted=True, meaning=f"{ticks} ticks rehearsed in {spent_ms:.0f} ms"
    )
