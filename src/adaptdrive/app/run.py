"""`adaptdrive run`: the daemon of one drive, whose lines never wait for a reader.

A pipe without a reader blocks its writer, and one that was closed raises. Neither may
reach the thread that controls a drive. What the queue cannot hold is dropped, oldest first, and
counted; the count is written as soon as a line gets through again.
"""

import asyncio
import contextlib
import functools
import io
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Coroutine, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from select import POLLOUT, poll
from typing import Any, TextIO, cast

import msgspec

from adaptdrive import __version__, build_name
from adaptdrive.app import examine, loads, ports, process, recording, reload, settings
from adaptdrive.config import Configuration
from adaptdrive.config.file import read_text
from adaptdrive.control.controller import Controller
from adaptdrive.mqtt.service import MqttService, OperatorLog
from adaptdrive.recording import log_files, records
from adaptdrive.recording.log_files import recall as recall_log
from adaptdrive.recording.recorder import Recorder
from adaptdrive.runtime import realtime, reports, tick_support
from adaptdrive.runtime.daemon import Daemon
from adaptdrive.util import clock
from adaptdrive.util.errors import AdaptdriveError, first_error
from adaptdrive.util.lines import bind, configured, line, write_line

# Output that never waits for its reader: lines go through a bounded queue to a thread.

LINES_HELD = 500
"""Lines that wait for a reader: more than an orderly end or a trip ever writes."""

PATIENCE_S = 2.0
"""Longest wait for a reader at the end of the process."""

_LOST = "lines lost: the reader of stderr had stopped reading"


class QueuedStream(io.TextIOBase):
    """Writes whole lines to the file of another stream, from a separate thread."""

    def __init__(self, target: TextIO, start_thread: Callable[[], None] = lambda: None) -> None:
        """Start the thread.

        Args:
            target: Stream on the file; it is not used itself.
            start_thread: What the thread does first.
        """
        super().__init__()
        self._file = target.fileno()
        self._start_thread = start_thread
        self._begun = ""
        self._lines: deque[str] = deque()
        self._lost = 0
        self._busy = False
        self._changed = threading.Condition()
        threading.Thread(target=self._work, name="output", daemon=True).start()

    def write(self, text: str) -> int:
        """Queue the lines that are complete; returns at once."""
        with self._changed:
            *lines, self._begun = (self._begun + text).split("\n")
            self._lines.extend(lines)
            while len(self._lines) > LINES_HELD:
                self._lines.popleft()
                self._lost += 1
            self._changed.notify_all()
        return len(text)

    def writable(self) -> bool:
        """Always."""
        return True

    def fileno(self) -> int:
        """The file that the lines end in."""
        return self._file

    def drain(self, deadline_s: float) -> bool:
        """Wait until every line has been written.

        Args:
            deadline_s: End of the wait, monotonic.

        Returns:
            Whether none waits and none was lost without a word.
        """
        with self._changed:
            return self._changed.wait_for(
                lambda: not (self._lines or self._busy or self._lost),
                max(0.0, deadline_s - time.monotonic()),
            )

    def _work(self) -> None:
        self._start_thread()
        while True:
            next_line, lost = self._next()
            announced = not lost or self._put(line("warning", _LOST, lost=lost))
            written = self._put(next_line)
            with self._changed:
                self._lost += (0 if announced else lost) + (0 if written else 1)
                self._busy = False
                self._changed.notify_all()

    def _next(self) -> tuple[str, int]:
        """Wait for a line; it, and how many went missing before it."""
        with self._changed:
            self._changed.wait_for(lambda: bool(self._lines))
            self._busy = True
            lost, self._lost = self._lost, 0
            return self._lines.popleft(), lost

    def _put(self, line: str) -> bool:
        """Write a line, for as long as that takes; False when the file refuses it."""
        rest = f"{line}\n".encode(errors="backslashreplace")
        while rest:
            try:
                rest = rest[os.write(self._file, rest) :]
            except BlockingIOError:  # another process with this file has made it non-blocking
                _await_room(self._file)
            except OSError:
                return False
        return True


def _await_room(file: int) -> None:
    waiting = poll()
    waiting.register(file, POLLOUT)
    waiting.poll()


@contextmanager
def unblocked_output(start_thread: Callable[[], None] = lambda: None) -> Iterator[None]:
    """Have everything that this process prints go through queues until the block ends.

    The plain streams come back when their readers have taken everything. Otherwise the queues stay:
    what is printed after the block must not hang either.

    Args:
        start_thread: What a thread does first.
    """
    plain = sys.stdout, sys.stderr
    queued = tuple(QueuedStream(stream, start_thread) for stream in plain)
    sys.stdout, sys.stderr = cast("tuple[TextIO, TextIO]", queued)
    try:
        yield
    finally:
        deadline_s = time.monotonic() + PATIENCE_S
        drained = [stream.drain(deadline_s) for stream in queued]
        if all(drained):
            sys.stdout, sys.stderr = plain


# `adaptdrive run`: the daemon of one drive.

UNRECORDED = 4
"""Exit status after an orderly stop whose session lacks its end."""

_EVENTS_HELD = 1000

_NAMES = "TERM INT QUIT HUP USR1 USR2 ALRM VTALRM PROF IO PWR XCPU STKFLT"
_ENDING = (
    *(signal.Signals[f"SIG{name}"] for name in _NAMES.split()),
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
    configuration = examine.examine_text(text, path)
    start_thread = realtime.helper_thread(configuration.realtime.priority)
    try:
        with (
            unblocked_output(start_thread),
            process.locked(process.lock_names(configuration), os.environ),
            asyncio.Runner() as runner,
        ):
            given = reload.RunInput(configuration, text)
            complete = runner.run(_serve(given, path, start_thread))
    except* AdaptdriveError as group:
        raise first_error(group) from None
    return 0 if complete else UNRECORDED


async def _serve(given: reload.RunInput, path: Path, start_thread: Callable[[], None]) -> bool:
    """Serve until asked to stop; False when the end of a session is not recorded."""
    configured()
    course = reload.RunCourse(path, given)
    # blocking calls do not have the priority of the control thread
    helpers = ThreadPoolExecutor(thread_name_prefix="helper", initializer=start_thread)
    asyncio.get_running_loop().set_default_executor(helpers)
    _stop_on_signals(course.end)
    feed = functools.partial(course.feed_between, tick_support.ServiceManager(os.environ))
    feeding = asyncio.create_task(clock.repeat(feed, reload.FEED_S))
    complete = True
    while (present := course.next_run()) is not None:
        complete &= await _run(present, course, start_thread)
    await _end(feeding)
    write_line("info", "stopped")
    return complete


async def _run(
    given: reload.RunInput, course: reload.RunCourse, start_thread: Callable[[], None]
) -> bool:
    """Serve until the run ends; False when the end of its session is not recorded."""
    configuration, hub = given.configuration, reports.Hub()
    events = hub.subscribe(reports.Event, size=_EVENTS_HELD)
    port = ports.build_whole_port(configuration, clock.now_s, course.path)
    law, load = settings.controller_settings(configuration), loads.build_load(configuration)
    recalled = recall_log(recording.place_of(configuration)[0], datetime.now(UTC))
    learnt, known = recording.recall(
        recalled.learnt, configuration, law, load, measured=given.measured
    )
    controller = Controller(law, load, learnt.values, learnt.resolution)
    recorder = recording.build_recorder(
        configuration, given.text, hub, recalled, learnt, start_thread
    )
    hub.kept = recorder.kept
    ports.publish_samples(port, hub.publish, clock.now_s)
    daemon = Daemon(
        port=port,
        controller=controller,
        configuration=configuration,
        machine=settings.machine_limits(configuration),
        fast=settings.fast_settings(configuration),
        clock=clock.now_s,
        hub=hub,
        manager=tick_support.ServiceManager(os.environ),
        sensors=ports.sensor_reports(port, clock.now_s),
        recorded=lambda: not recorder.failing,
        prepare=course.prepare,
    )
    bind(drive=configuration.drive.name, session=recorder.session_name)
    write_line("info", "starting", version=__version__, build=build_name(), bus=port.description)
    async with asyncio.TaskGroup() as tasks, contextlib.AsyncExitStack() as ending:
        # ended in reverse: broker and stderr receive the last reports of those that end before them
        def start(name: str, service: Coroutine[Any, Any, None]) -> None:
            ending.push_async_callback(_end, tasks.create_task(service, name=name))

        start("lines", reload.write_events(events, hub.kept))
        start("recorder", recorder.run(daemon.opened))
        profile = settings.operator_profile(configuration)
        around = operator_log(recalled, recorder)
        profile = replace(profile, quantities=recording.health_names(configuration))
        start("mqtt", MqttService(profile, configuration.mqtt, daemon, hub, around).run())
        start("opened", course.opened(daemon.opened))
        if recording.is_kept(law):
            note = _note(configuration, recorder)
            if given.measured:
                note(learnt)

            def present() -> recording.Learnt:
                return recording.Learnt(controller.trusted, controller.resolution)

            start("checkpoint", recording.keep_learnt(note, present, hub, clock.now_s))
        for event in reload.start_events(given, known, recalled):
            hub.publish(event)
        with (
            clock.uncaught_errors_end(daemon.fail),
            process.prepared(configuration, course.path, hub),
        ):
            await daemon.run(course.stop)
    return recorder.complete


def operator_log(recalled: log_files.Recalled, recorder: Recorder) -> OperatorLog:
    """Return the log as the operators' side sees it.

    Args:
        recalled: What an earlier run has left in it.
        recorder: Appends to it.
    """

    def note_reply(identity: str, body: bytes) -> None:
        recorder.note(records.Kind.REPLY, msgspec.msgpack.encode((identity, body)))

    return OperatorLog(
        replies=recalled.replies,
        events=[(row.time, row.event) for row in recalled.unsent],
        trip=None if recalled.trip is None else (recalled.trip.time, recalled.trip.event),
        note_reply=note_reply,
        note_sent=lambda: recorder.note(records.Kind.SENT, b""),
        kept=recorder.kept,
    )


async def _end(service: asyncio.Task[Any]) -> None:
    """End a service; each bounds the time that this takes."""
    service.cancel()
    await asyncio.wait([service])


def _stop_on_signals(end: Callable[[], None]) -> None:
    """Have each signal that would end the process do so in order; `nohup` is respected."""
    loop = asyncio.get_running_loop()
    for number in _ENDING:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
            loop.add_signal_handler(number, end)


def _note(configuration: Configuration, recorder: Recorder) -> Callable[[recording.Learnt], None]:
    """Return what has the log keep estimates of a configuration."""
    key, names = recording.configuration_key(configuration), loads.build_load(configuration).names

    def note(learnt: recording.Learnt) -> None:
        recorder.note(records.Kind.LEARNT, recording.checkpoint_record(key, names, learnt))

    return note
