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
from pathlib import Path
from typing import Any

from adaptdrive import __version__
from adaptdrive.app.checkpoint import (
    Keeper,
    checkpoint_path,
    configuration_key,
    controller_from,
    is_kept,
    recall,
    write_checkpoint,
)
from adaptdrive.app.directory import directory_flaw
from adaptdrive.app.examine import examine_text
from adaptdrive.app.last_resort import uncaught_errors_end
from adaptdrive.app.loads import build_load
from adaptdrive.app.lock import lock_names, locked, send_visitors_away
from adaptdrive.app.log import log_events, loss_line, set_up_logging
from adaptdrive.app.output import unblocked_output
from adaptdrive.app.profile import operator_profile
from adaptdrive.app.realtime import build_rehearsal, prepared
from adaptdrive.app.recording import build_recorder
from adaptdrive.app.sensors import build_whole_port, publish_samples, sensor_reports
from adaptdrive.app.settings import controller_settings, daemon_settings
from adaptdrive.app.warm_up import Rehearsal
from adaptdrive.clock.now import now_s
from adaptdrive.config import Configuration
from adaptdrive.config.file import read_text
from adaptdrive.control.controller import Controller
from adaptdrive.errors import AdaptdriveError, first_error
from adaptdrive.hardware.port import Port
from adaptdrive.operation.service import MqttService, ServiceSurroundings
from adaptdrive.pure import build_name
from adaptdrive.recording.recorder import Recorder
from adaptdrive.runtime.daemon import Daemon
from adaptdrive.runtime.hub import Hub
from adaptdrive.runtime.latency import WatchedLoop
from adaptdrive.runtime.realtime import helper_thread
from adaptdrive.runtime.reports import Event, Severity
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
            unblocked_output(loss_line, start_thread),
            locked(lock_names(configuration), os.environ) as locks,
            asyncio.Runner(loop_factory=WatchedLoop) as runner,
        ):
            complete = runner.run(_serve(configuration, text, path, locks))
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
        recorder: None where nothing is recorded.
        keeper: Writes the checkpoint of the estimates, None where none is kept.
        news: Events that the building of the parts gave.
    """

    daemon: Daemon
    bus: str
    rehearsal: Rehearsal
    recorder: Recorder | None
    keeper: Keeper | None
    news: tuple[Event, ...]


async def _serve(
    configuration: Configuration,
    text: str,
    path: Path,
    locks: Sequence[socket.socket],
) -> bool:
    """Serve until asked to stop; False when the end of the session is not recorded."""
    logger, hub, stop = set_up_logging(), Hub(), asyncio.Event()
    events = hub.subscribe(Event, size=_EVENTS_HELD)
    start_thread = _use_helper_threads(configuration)
    parts = _build(configuration, text, path, hub, start_thread)
    daemon, recorder, keeper = parts.daemon, parts.recorder, parts.keeper
    _stop_on_signals(stop)
    logger.info(
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
        start("log", log_events(events, logger, hub.kept))
        if recorder is not None:
            ending.push_async_callback(recorder.add_late)
        start("mqtt", _mqtt(configuration, daemon, hub, start_thread).run())
        if recorder is not None:
            start("recorder", recorder.run(daemon.opened))
        if keeper is not None:
            ending.push_async_callback(keeper.save)
            start("checkpoint", keeper.run())
        for event in parts.news:
            hub.publish(event)
        with uncaught_errors_end(daemon.fail), prepared(configuration, parts.rehearsal, hub):
            await daemon.run(stop)
    logger.info("stopped", drive=configuration.drive.name)
    return recorder is None or recorder.complete


def _build(
    configuration: Configuration,
    text: str,
    path: Path,
    hub: Hub,
    start_thread: Callable[[], None],
) -> _Parts:
    port = build_whole_port(configuration, now_s, path)
    settings, load = controller_settings(configuration), build_load(configuration)
    state = state_directory(os.environ.get("STATE_DIRECTORY", ""))
    checkpoint = checkpoint_path(state, configuration.drive.name)
    learnt, recalled = recall(checkpoint, configuration, settings, load)
    controller = controller_from(settings, load, learnt)
    rehearsal = build_rehearsal(configuration, path)
    recorder = build_recorder(configuration, text, hub, learnt, start_thread)
    if recorder is not None:
        hub.keep_with(recorder.keep)
        publish_samples(port, hub.publish, now_s)
    return _Parts(
        daemon=_daemon(configuration, port, controller, hub, rehearsal, recorder),
        bus=port.description,
        rehearsal=rehearsal,
        recorder=recorder,
        keeper=_keeper(configuration, checkpoint, controller, hub) if is_kept(settings) else None,
        news=tuple(filter(None, (recalled, state_event(state)))),
    )


def _daemon(  # noqa: PLR0913, PLR0917 - the parts of a daemon
    configuration: Configuration,
    port: Port,
    controller: Controller,
    hub: Hub,
    rehearsal: Rehearsal,
    recorder: Recorder | None,
) -> Daemon:
    return Daemon(
        port=port,
        controller=controller,
        settings=daemon_settings(configuration),
        clock=now_s,
        hub=hub,
        manager=ServiceManager(os.environ),
        sensors=sensor_reports(port, now_s),
        rehearse=rehearsal.tick,
        recorded=lambda: recorder is None or not recorder.failing,
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


def _stop_on_signals(stop: asyncio.Event) -> None:
    """Have each signal that would end the process do so in order; `nohup` is respected."""
    loop = asyncio.get_running_loop()
    for number in _ENDING:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            loop.add_signal_handler(number, stop.set)


def _mqtt(
    configuration: Configuration, daemon: Daemon, hub: Hub, start_thread: Callable[[], None]
) -> MqttService:
    directory = state_directory(os.environ.get("STATE_DIRECTORY", ""))
    surroundings = ServiceSurroundings(directory, start_thread=start_thread)
    profile = operator_profile(configuration)
    return MqttService(profile, configuration.mqtt, daemon, hub, surroundings)


def state_directory(given: str) -> Path:
    """Return the state directory of the daemon: the service manager's folder, else `./state`."""
    first = given.split(":", maxsplit=1)[0]
    return Path(first) if first else Path("state")


def state_event(directory: Path) -> Event | None:
    """Return the event that reports an unusable state directory, None for a usable one."""
    flaw = directory_flaw(directory)
    if flaw is None:
        return None
    lost = "replies, unsent events and estimates do not survive a restart"
    return Event("state directory", Severity.WARNING, f"{directory}: {flaw}: {lost}", -1)


def _keeper(configuration: Configuration, path: Path, controller: Controller, hub: Hub) -> Keeper:
    key, names = configuration_key(configuration), build_load(configuration).names
    return Keeper(lambda learnt: write_checkpoint(path, key, names, learnt), controller, hub, now_s)
