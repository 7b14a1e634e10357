"""`adaptdrive run`: the daemon of one drive."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import os
import signal
import socket
from collections.abc import Callable, Coroutine, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from adaptdrive import __version__
from adaptdrive.app.checkpoint import (
    Keeper,
    Learnt,
    checkpoint_record,
    configuration_key,
    controller_from,
    is_kept,
    learnt_by,
    measured,
    recall,
)
from adaptdrive.app.examine import examine_text
from adaptdrive.app.last_resort import uncaught_errors_end
from adaptdrive.app.loads import build_load
from adaptdrive.app.lock import lock_names, locked, send_visitors_away
from adaptdrive.app.log import log_events
from adaptdrive.app.news import news_of
from adaptdrive.app.output import unblocked_output
from adaptdrive.app.ports import build_port, build_whole_port, publish_samples, sensor_reports
from adaptdrive.app.profile import operator_profile
from adaptdrive.app.realtime import Rehearsal, prepared
from adaptdrive.app.recording import build_recorder, ledger_of, place_of
from adaptdrive.app.reload import Given, RunCourse
from adaptdrive.app.settings import controller_settings, daemon_settings
from adaptdrive.clock.now import now_s
from adaptdrive.config import Configuration
from adaptdrive.config.file import read_text
from adaptdrive.errors import AdaptdriveError, first_error
from adaptdrive.lines import log
from adaptdrive.operation.ledger import Ledger
from adaptdrive.operation.service import MqttService, ServiceSurroundings
from adaptdrive.pure import build_name
from adaptdrive.recording.frames import Kind
from adaptdrive.recording.log_files import recall as recall_log
from adaptdrive.recording.recorder import Recorder
from adaptdrive.runtime.daemon import Daemon
from adaptdrive.runtime.hub import Hub
from adaptdrive.runtime.latency import WatchedLoop
from adaptdrive.runtime.realtime import helper_thread
from adaptdrive.runtime.reports import Event
from adaptdrive.runtime.watchdog import ServiceManager

UNRECORDED = 4
"""Exit status after an orderly stop whose session lacks its end."""

_EVENTS_HELD = 1000

_ENDING = (
    signal.SIGTERM,
    signal.SIGINT,
    signal.SIGQUIT,
    signal.SIGHUP,
    signal.SIGUSR1,
    signal.SIGUSR2,
    signal.SIGALRM,
    signal.SIGVTALRM,
    signal.SIGPROF,
    signal.SIGIO,
    signal.SIGPWR,
    signal.SIGXCPU,
    signal.SIGSTKFLT,
    *range(signal.SIGRTMIN, signal.SIGRTMAX + 1),
)
"""Signals that end a process by default; those of a crash, SIGABRT among them, stay as they are."""


def run(path: Path) -> int:
    """Run the daemon until SIGTERM or SIGINT; the drive is left in its safe state.

    Args:
        path: Configuration file.

    Returns:
        Exit status: 0 after an orderly stop, 4 when the end of its session is not recorded.

    Raises:
        AdaptdriveError: The configuration or the bus cannot be used, or another daemon of this
            machine controls the drive.
    """
    text = read_text(path)
    configuration = examine_text(text, path)
    start_thread = helper_thread(configuration.realtime.priority)
    try:
        with (
            unblocked_output(start_thread),
            locked(lock_names(configuration), os.environ) as locks,
            asyncio.Runner(loop_factory=WatchedLoop) as runner,
        ):
            complete = runner.run(_serve(Given(configuration, text), path, locks))
    except* AdaptdriveError as group:
        raise first_error(group) from None
    return 0 if complete else UNRECORDED


@dataclass(frozen=True, slots=True)
class _Parts:
    """Parts of the daemon of one drive, built and not started.

    Attributes:
        daemon: Fast loop, slow loop and state machine.
        bus: The bus in one phrase.
        rehearsal: What is computed once before the first tick.
        recorder: Appends to the log.
        ledger: The log, as the operators' side sees it.
        keeper: Has the log keep estimates, None where none are kept.
        news: Events that the building of the parts gave.
    """

    daemon: Daemon
    bus: str
    rehearsal: Rehearsal
    recorder: Recorder
    ledger: Ledger
    keeper: Keeper | None
    news: tuple[Event, ...]


async def _serve(given: Given, path: Path, locks: Sequence[socket.socket]) -> bool:
    """Serve until asked to stop; False when the end of a session is not recorded."""
    course = RunCourse(path, given)
    start_thread = _use_helper_threads(given.configuration)
    _stop_on_signals(course.end)
    feeding = asyncio.create_task(course.feed_between(ServiceManager(os.environ)))
    complete = True
    while (present := course.next_run()) is not None:
        complete &= await _run(present, course, path, locks, start_thread)
    await _end(feeding)
    log("info", "stopped", drive=given.configuration.drive.name)
    return complete


async def _run(
    given: Given,
    course: RunCourse,
    path: Path,
    locks: Sequence[socket.socket],
    start_thread: Callable[[], None],
) -> bool:
    """Serve until the run ends; False when the end of its session is not recorded."""
    configuration, hub = given.configuration, Hub()
    events = hub.subscribe(Event, size=_EVENTS_HELD)
    parts = _build(given, course, path, hub, start_thread)
    daemon, recorder, keeper = parts.daemon, parts.recorder, parts.keeper
    log(
        "info",
        "starting",
        drive=configuration.drive.name,
        version=__version__,
        build=build_name(),
        bus=parts.bus,
    )
    async with asyncio.TaskGroup() as tasks, contextlib.AsyncExitStack() as ending:
        # ended in reverse: broker and log receive the last reports of those that end before them
        start = functools.partial(_start, tasks, ending)
        start("lock", send_visitors_away(locks))
        start("log", log_events(events, hub.kept))
        start("recorder", recorder.run(daemon.opened))
        profile, around = operator_profile(configuration), ServiceSurroundings(parts.ledger)
        start("mqtt", MqttService(profile, configuration.mqtt, daemon, hub, around).run())
        start("opened", course.opened(daemon.opened))
        if keeper is not None:
            ending.callback(keeper.save)
            start("checkpoint", keeper.run())
        for event in parts.news:
            hub.publish(event)
        with uncaught_errors_end(daemon.fail), prepared(configuration, parts.rehearsal, hub):
            await daemon.run(course.stop)
    return recorder.complete


def _build(
    given: Given,
    course: RunCourse,
    path: Path,
    hub: Hub,
    start_thread: Callable[[], None],
) -> _Parts:
    configuration = given.configuration
    port = build_whole_port(configuration, now_s, path)
    settings, load = controller_settings(configuration), build_load(configuration)
    recalled = recall_log(place_of(configuration).log, datetime.now(UTC))
    learnt, known = recall(recalled.learnt, configuration, settings, load)
    if given.measured and is_kept(settings):
        learnt, known = measured(load, learnt)
    controller = controller_from(settings, load, learnt)
    rehearsal = Rehearsal(configuration, build_port(configuration, now_s, path))
    recorder = build_recorder(configuration, given.text, hub, recalled, learnt, start_thread)
    hub.kept = recorder.kept
    publish_samples(port, hub.publish, now_s)
    keeper = None
    if is_kept(settings):
        note = _note(configuration, recorder)
        keeper = Keeper(note, functools.partial(learnt_by, controller), hub, now_s)
        if given.measured and learnt is not None:
            note(learnt)
    daemon = Daemon(
        port=port,
        controller=controller,
        settings=daemon_settings(configuration),
        clock=now_s,
        hub=hub,
        manager=ServiceManager(os.environ),
        sensors=sensor_reports(port, now_s),
        rehearse=rehearsal.tick,
        recorded=lambda: not recorder.failing,
        prepare=course.prepare,
    )
    return _Parts(
        daemon=daemon,
        bus=port.description,
        rehearsal=rehearsal,
        recorder=recorder,
        ledger=ledger_of(recalled, recorder),
        keeper=keeper,
        news=tuple(news_of(given, known, recalled)),
    )


def _use_helper_threads(configuration: Configuration) -> Callable[[], None]:
    """Keep blocking calls off the control thread's priority; return the start of such a thread."""
    start_thread = helper_thread(configuration.realtime.priority)
    asyncio.get_running_loop().set_default_executor(
        ThreadPoolExecutor(thread_name_prefix="helper", initializer=start_thread)
    )
    return start_thread


def _start(
    tasks: asyncio.TaskGroup,
    ending: contextlib.AsyncExitStack,
    name: str,
    service: Coroutine[Any, Any, None],
) -> None:
    """Start a service that `ending` ends; each bounds the time that this takes."""
    ending.push_async_callback(_end, tasks.create_task(service, name=name))


async def _end(service: asyncio.Task[None]) -> None:
    service.cancel()
    await asyncio.wait([service])


def _stop_on_signals(end: Callable[[], None]) -> None:
    """Have each signal that would end the process do so in order; `nohup` is respected."""
    loop = asyncio.get_running_loop()
    for number in _ENDING:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            loop.add_signal_handler(number, end)


def _note(configuration: Configuration, recorder: Recorder) -> Callable[[Learnt], None]:
    """Return what has the log keep estimates of a configuration."""
    key, names = configuration_key(configuration), build_load(configuration).names

    def note(learnt: Learnt) -> None:
        recorder.note(Kind.LEARNT, checkpoint_record(key, names, learnt))

    return note
