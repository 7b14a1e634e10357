"""The recorder process: reads batches from its standard input and puts them on disk.

It ends when its input ends, which it does in every way that the control process can go. It is
started by the recorder service as `python -m adaptdrive.recording.writer DIRECTORY`.
"""

from __future__ import annotations

import math
import os
import signal
import sqlite3
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import msgspec
import pyarrow as pa

from adaptdrive.recording.batches import Batch, Header, read_frames
from adaptdrive.recording.event_log import EventLog
from adaptdrive.recording.session import (
    CONFIG_FILE,
    EVENTS_FILE,
    SLOW,
    TICKS,
    Dropped,
    Ending,
    write_info,
)
from adaptdrive.recording.streams import StreamWriter, convert
from adaptdrive.recording.tables import SLOW_SCHEMA, TICKS_SCHEMA, slow_batch, ticks_batch
from adaptdrive.runtime.statistics import BINS, bin_of

_TIMES = ("lateness_us", "turnaround_us", "tick_us")
_SCHEMAS = {TICKS: TICKS_SCHEMA, SLOW: SLOW_SCHEMA}


class SessionWriter:
    """The files of one session while it is written."""

    def __init__(self, directory: Path, header: Header) -> None:
        self._directory = directory
        self._info = header.info
        (directory / CONFIG_FILE).write_text(header.config_text, encoding="utf-8")
        self._streams = {
            name: StreamWriter(directory / f"{name}.arrows", schema)
            for name, schema in _SCHEMAS.items()
        }
        self._events = EventLog(directory / EVENTS_FILE)
        self._histograms = {name: [0] * BINS for name in _TIMES}
        # Last, so that a directory with this file holds all the others.
        write_info(directory, header.info)

    def write(self, batch: Batch) -> None:
        """Put one batch on disk, events first: they are few and matter most."""
        if batch.events:
            self._events.append(batch.events)
        if batch.tick_rows:
            ticks = ticks_batch(batch.ticks, batch.tick_rows)
            self._streams[TICKS].write(ticks)
            self._count(ticks)
        if batch.slow:
            self._streams[SLOW].write(slow_batch(batch.slow))

    def close(self, ending: Ending, dropped: Dropped) -> None:
        """Close everything; then, at leisure, turn the streams into Parquet."""
        for stream in self._streams.values():
            stream.close()
        self._events.close()
        histograms = {name: tuple(counts) for name, counts in self._histograms.items()}
        info = msgspec.structs.replace(
            self._info, ended=ending, dropped=dropped, histograms=histograms
        )
        write_info(self._directory, info)
        for name, schema in _SCHEMAS.items():
            stream_path = self._directory / f"{name}.arrows"
            convert(stream_path, self._directory / f"{name}.parquet", schema)

    def _count(self, ticks: pa.RecordBatch) -> None:
        """Count times of ticks; a stand-in tick has no turn-around."""
        for name, counts in self._histograms.items():
            for time_us in ticks.column(name).to_pylist():
                if not math.isnan(time_us):
                    counts[bin_of(time_us)] += 1


def record(directory: Path, source: BinaryIO) -> None:
    """Record one session from a stream of messages until that ends.

    Args:
        directory: The session's directory, which exists.
        source: Messages; nothing is made of a source without any.
    """
    frames = read_frames(source)
    first = next(frames, None)
    if first is None:
        return
    writer = SessionWriter(directory, msgspec.msgpack.decode(first, type=Header))
    ending, dropped = Ending.CUT, Dropped()
    for batch in _batches(frames):
        writer.write(batch)
        ending, dropped = Ending.ORDERLY if batch.last else Ending.CUT, batch.dropped
    writer.close(ending, dropped)


def _batches(frames: Iterator[bytes]) -> Iterator[Batch]:
    decoder = msgspec.msgpack.Decoder(Batch)
    return map(decoder.decode, frames)


def _step_aside() -> None:
    """Leave the processor and the signals to the control process, whose child this is."""
    # A service manager and a terminal signal every process; this one ends with its input.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGABRT):
        signal.signal(number, signal.SIG_IGN)
    # Real-time priority is inherited.
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(5)


def main() -> None:
    """Run the recorder process."""
    _step_aside()
    directory = Path(sys.argv[1])
    try:
        record(directory, sys.stdin.buffer)
    except (OSError, sqlite3.Error, pa.ArrowException, msgspec.MsgspecError) as problem:
        # Leave at once: closing what cannot be written would only fail again.
        print(f"{directory}: {problem}", file=sys.stderr, flush=True)  # noqa: T201
        os._exit(1)


if __name__ == "__main__":
    main()
