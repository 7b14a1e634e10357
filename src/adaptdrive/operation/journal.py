"""A small SQLite file that is written by a thread of its own, so that a slow disk delays nobody.

What is kept here is also held in memory by its owner: the file serves restarts. A disk that
fails is therefore logged once, and operation goes on without it.
"""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import structlog

T = TypeVar("T")

_SCHEMA = (
    "PRAGMA journal_mode = WAL",
    "PRAGMA synchronous = FULL",
    "CREATE TABLE IF NOT EXISTS reply (id TEXT PRIMARY KEY, time_s REAL, body BLOB)",
    "CREATE TABLE IF NOT EXISTS event (sequence INTEGER PRIMARY KEY, body BLOB)",
)


class Journal:
    """One SQLite file, one thread, statements in the order in which they were posted."""

    def __init__(self, path: Path, start_thread: Callable[[], None] = lambda: None) -> None:
        """Open nothing yet.

        Args:
            path: The file.
            start_thread: What the thread does first.
        """
        self._path = path
        self._executor = ThreadPoolExecutor(1, "journal", initializer=start_thread)
        self._database: sqlite3.Connection | None = None
        self._log = structlog.get_logger().bind(journal=str(path))

    async def open(self) -> None:
        """Open the file, or make it; a damaged one is put aside."""
        await asyncio.wrap_future(self._executor.submit(self._open))

    async def rows(self, query: str) -> list[tuple[Any, ...]]:
        """All rows of a query; none where the file cannot be read."""
        work = self._submit(lambda database: database.execute(query).fetchall())
        return await asyncio.wrap_future(work) or []

    def post(self, statement: str, parameters: tuple[object, ...] = ()) -> None:
        """Have a statement carried out soon, in order; returns at once."""
        self._submit(lambda database: database.execute(statement, parameters))

    async def written(self, patience_s: float) -> bool:
        """Wait until all that was posted so far is on disk.

        Args:
            patience_s: Longest wait; a disk that hangs must not keep an operator from acting.

        Returns:
            False when the wait was given up.
        """
        work = asyncio.wrap_future(self._executor.submit(lambda: None))
        done, _ = await asyncio.wait([work], timeout=patience_s)
        return bool(done)

    async def close(self) -> None:
        """Write what was posted and close the file."""
        await asyncio.wrap_future(self._executor.submit(self._close))
        self._executor.shutdown(wait=False)

    def _submit(self, work: Callable[[sqlite3.Connection], T]) -> Future[T | None]:
        return self._executor.submit(self._attempt, work)

    def _attempt(self, work: Callable[[sqlite3.Connection], T]) -> T | None:
        if self._database is None:
            return None
        try:
            return work(self._database)
        except sqlite3.Error as problem:
            self._log.error("journal cannot be used", problem=str(problem))
            return None

    def _open(self) -> None:
        try:
            self._database = self._connect()
        except sqlite3.DatabaseError as problem:
            self._log.error("journal put aside", problem=str(problem))
            self._database = self._connect_afresh()
        except OSError as problem:
            self._log.error("operating without a journal", problem=str(problem))

    def _connect_afresh(self) -> sqlite3.Connection | None:
        try:
            self._path.replace(self._path.with_name(self._path.name + ".damaged"))
            return self._connect()
        except (OSError, sqlite3.Error) as problem:
            self._log.error("operating without a journal", problem=str(problem))
            return None

    def _connect(self) -> sqlite3.Connection:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        database = sqlite3.connect(self._path, timeout=1.0, isolation_level=None)
        try:
            for statement in _SCHEMA:
                database.execute(statement)
        except sqlite3.Error:
            database.close()
            raise
        return database

    def _close(self) -> None:
        if self._database is not None:
            self._database.close()
            self._database = None
