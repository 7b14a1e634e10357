"""A small SQLite file, written by a separate thread, so that a slow disk delays no command.

What is kept here is also held in memory by its owner: the file serves restarts. Statements that are
posted while the file cannot be used are discarded; when it can be used again, its owners write all
that they hold. A file is replaced only when SQLite reports it damaged, and made anew when it was
deleted: SQLite itself goes on writing into a file that nobody can open any more.
"""

from __future__ import annotations

import asyncio
import sqlite3
import stat
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import structlog

Statement = tuple[str, tuple[object, ...]]

LARGEST_BACKLOG = 50_000
"""Statements that wait for a disk that hangs: all that the owners hold, several times over."""

_SCHEMA = (
    # without memory mapped from the disk: one that fails under it would end this process
    "PRAGMA locking_mode = EXCLUSIVE",
    "PRAGMA journal_mode = WAL",
    "PRAGMA synchronous = FULL",
    "BEGIN",
    "CREATE TABLE IF NOT EXISTS reply (id TEXT PRIMARY KEY, time_s REAL, body BLOB)",
    "CREATE TABLE IF NOT EXISTS event (sequence INTEGER PRIMARY KEY, body BLOB)",
    "CREATE TABLE IF NOT EXISTS trip (id INTEGER PRIMARY KEY, body BLOB)",
    "COMMIT",
)
_DAMAGED = (sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_CORRUPT)
_UNUSABLE = (sqlite3.Error, UnicodeDecodeError, MemoryError)
"""Errors of a statement: SQLite's message about a damaged name is no text, and it may ask for more
memory than there is for what a damaged file says."""
_PRIMARY_CODE = 0xFF  # the low byte of an extended result code
_DELETED = "the file was deleted, or another one has taken its place"


class Journal:
    """One SQLite file, one thread; statements go in the order of posting, many to a transaction.

    Attributes:
        path: The file.
        problem: Why the file cannot be used; empty while it can, and before it was opened.
        put_aside: What was damaged and put aside; empty where nothing was.
    """

    def __init__(self, path: Path, start_thread: Callable[[], None] = lambda: None) -> None:
        """Open nothing yet.

        Args:
            path: The file.
            start_thread: What the thread does first.
        """
        self.problem = ""
        self.put_aside = ""
        self.path = path
        self._executor = ThreadPoolExecutor(1, "journal", initializer=start_thread)
        self._database: sqlite3.Connection | None = None
        self._inode: tuple[int, int] | None = None
        self._pending: deque[Statement] = deque(maxlen=LARGEST_BACKLOG)
        self._log = structlog.get_logger().bind(journal=str(path))

    async def open(self) -> bool:
        """Open the file, or make it; a damaged one is put aside.

        An open file that was deleted is closed: the next call makes a new one.

        Returns:
            Whether it was opened now; False when it is open already, was deleted, or cannot be
            opened.
        """
        return await asyncio.wrap_future(self._executor.submit(self._open))

    async def rows(self, query: str) -> list[tuple[Any, ...]]:
        """All rows of a query; none where the file cannot be read."""
        return await asyncio.wrap_future(self._executor.submit(self._rows, query))

    def post(self, statement: str, parameters: tuple[object, ...] = ()) -> None:
        """Have a statement carried out soon, in order; returns at once."""
        self._pending.append((statement, parameters))
        if len(self._pending) == 1:
            self._executor.submit(self._write)

    async def written(self, patience_s: float) -> bool:
        """Wait until all that was posted so far is on disk.

        Args:
            patience_s: Longest wait; a disk that hangs must not keep an operator from acting.

        Returns:
            False when the wait was given up.
        """
        work = asyncio.wrap_future(self._executor.submit(self._write))
        done, _ = await asyncio.wait([work], timeout=patience_s)
        return bool(done)

    async def close(self, patience_s: float) -> None:
        """Write what was posted and close the file; give up on a disk that hangs."""
        work = asyncio.wrap_future(self._executor.submit(self._close))
        await asyncio.wait([work], timeout=patience_s)
        self._executor.shutdown(wait=False)

    def _rows(self, query: str) -> list[tuple[Any, ...]]:
        if self._database is not None:
            try:
                return self._database.execute(query).fetchall()
            except _UNUSABLE as problem:
                self._fail(str(problem))
        return []

    def _write(self) -> None:
        """Carry out all that waits, in one transaction."""
        statements = list(self._taken())
        if self._database is None or not statements:
            return
        if len(statements) >= LARGEST_BACKLOG:
            self._fail("the disk is too slow: statements were discarded")
            return
        try:
            self._database.execute("BEGIN")
            for statement, parameters in statements:
                self._database.execute(statement, parameters)
            self._database.execute("COMMIT")
        except _UNUSABLE as problem:
            self._fail(str(problem))

    def _taken(self) -> Iterator[Statement]:
        # Until it is empty: `post` wakes this thread for the first of those that wait only.
        with suppress(IndexError):
            while True:
                yield self._pending.popleft()

    def _open(self) -> bool:
        if self._database is not None:
            if _inode(self.path) != self._inode:
                self._fail(_DELETED)
            return False
        try:
            self._database = self._connect()
        except sqlite3.Error as problem:
            self._database = self._replaced(problem)
        except OSError as problem:
            self._report(str(problem))
        if self._database is None:
            return False
        self._inode = _inode(self.path)
        if self.problem:
            self._log.info("journal in use")
        self.problem = ""
        return True

    def _replaced(self, problem: sqlite3.Error) -> sqlite3.Connection | None:
        """Start afresh beside a damaged file; keep one that merely cannot be opened now."""
        if _is_damage(problem):
            try:
                return self._connect()
            except (OSError, sqlite3.Error) as further:
                problem = sqlite3.DatabaseError(str(further))
        self._report(str(problem))
        return None

    def _put_aside(self, problem: sqlite3.Error) -> None:
        self._log.error("journal put aside", problem=str(problem))
        self.put_aside = f"{problem}: it is kept as {self.path.name}.damaged, and not used"
        name = self.path.name
        for suffix in ("-wal", "-shm", ""):
            with suppress(OSError):
                aside = self.path.with_name(f"{name}.damaged{suffix}")
                self.path.with_name(name + suffix).replace(aside)

    def _connect(self) -> sqlite3.Connection:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        _require_file(self.path)
        database = sqlite3.connect(self.path, timeout=1.0, isolation_level=None)
        database.text_factory = _text
        try:
            _prepare(database)
        except sqlite3.Error as problem:
            if _is_damage(problem):
                self._put_aside(problem)  # before SQLite deletes the log of what was not merged
            database.close()
            raise
        return database

    def _fail(self, problem: str) -> None:
        self._report(problem)
        self._disconnect()

    def _report(self, problem: str) -> None:
        """Log a problem once, until it is another one or gone."""
        if problem != self.problem:
            self._log.error("operating without a journal", problem=problem)
        self.problem = problem

    def _close(self) -> None:
        self._write()
        self._disconnect()

    def _disconnect(self) -> None:
        if self._database is not None:
            with suppress(sqlite3.Error):
                self._database.close()
            self._database = None


class _DamageError(sqlite3.DatabaseError):
    """SQLite's own check has found damage."""

    sqlite_errorcode = sqlite3.SQLITE_CORRUPT


def _prepare(database: sqlite3.Connection) -> None:
    try:
        for statement in _SCHEMA:
            database.execute(statement)
        _check(database)
    except UnicodeDecodeError as problem:
        raise _DamageError(f"damaged: {problem}") from problem
    except MemoryError as problem:  # of a damaged file, or of a full machine: it is not replaced
        raise sqlite3.OperationalError("it takes more memory than there is") from problem


def _check(database: sqlite3.Connection) -> None:
    found = database.execute("PRAGMA quick_check(1)").fetchall()
    if found != [("ok",)]:
        raise _DamageError(f"damaged: {found[0][0] if found else 'no answer'}")


def _is_damage(problem: sqlite3.Error) -> bool:
    code = getattr(problem, "sqlite_errorcode", sqlite3.SQLITE_OK)
    return code & _PRIMARY_CODE in _DAMAGED


def _inode(path: Path) -> tuple[int, int] | None:
    """Return device and number of a file, None where there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _require_file(path: Path) -> None:
    """Refuse a FIFO or a device, which SQLite would wait for or write into."""
    if path.exists() and not stat.S_ISREG(path.stat().st_mode):
        raise OSError(f"{path} is not a file")


def _text(raw: bytes) -> str:
    return raw.decode("utf-8", "replace")
