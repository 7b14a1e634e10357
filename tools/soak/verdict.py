"""Judgement of a recorded session, in a process of its own: it is read and replayed there.

What a replay takes of memory would else count as the daemon's.
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from adaptdrive.analysis.replay import replay
from adaptdrive.app.loads import build_load
from adaptdrive.app.settings import controller_settings
from adaptdrive.config.root import Configuration
from adaptdrive.control.controller import Controller
from adaptdrive.recording.reader import read_session


@dataclass(frozen=True, slots=True)
class Published:
    """What a session must hold.

    Attributes:
        ticks: Ticks that were published.
        events: Events that were published.
        dropped: Whether a queue was too short.
    """

    ticks: int
    events: int
    dropped: bool


@dataclass(frozen=True, slots=True)
class Judged:
    """One session that was closed, read and replayed.

    Attributes:
        ticks: Ticks that were replayed.
        slow_steps: Slow steps that were replayed.
        events: Events that were read.
        flaws: What is not as it should be.
    """

    ticks: int
    slow_steps: int
    events: int
    flaws: tuple[str, ...]


def judge_elsewhere(folder: Path, configuration: Configuration, published: Published) -> Judged:
    """Judge a session in another process, which ends with it.

    Args:
        folder: The session.
        configuration: Of its daemon.
        published: What its daemon has reported.
    """
    context = get_context("forkserver")
    context.set_forkserver_preload([__name__])
    with ProcessPoolExecutor(1, context) as pool:
        return pool.submit(judge, folder, configuration, published).result()


def judge(folder: Path, configuration: Configuration, published: Published) -> Judged:
    """Read and replay a session; arguments as of `judge_elsewhere`."""
    session = read_session(folder)
    if not published.ticks:
        return Judged(0, 0, len(session.events), ())
    settings, load = controller_settings(configuration), build_load(configuration)
    report = replay(session, Controller(settings, load))
    flaws = [] if report.exact else [str(report)]
    if report.differing_decisions:
        flaws.append(f"{report.differing_decisions} slow steps differ")
    if report.ticks != published.ticks:
        flaws.append(f"{published.ticks} ticks published, {report.ticks} recorded")
    if len(session.events) != published.events:
        flaws.append(f"{published.events} events, {len(session.events)} recorded")
    if published.dropped:
        flaws.append("a queue was too short")
    return Judged(report.ticks, report.slow_steps, len(session.events), tuple(flaws))
