"""Runs in processes of their own, and the bar that shows how many are done."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager

from rich.console import Console
from rich.progress import MofNCompleteColumn, Progress


def processes(count: int) -> ProcessPoolExecutor:
    """Return processes that inherit nothing and end quietly on Ctrl-C."""
    return ProcessPoolExecutor(
        max_workers=count,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=signal.signal,
        initargs=(signal.SIGINT, signal.SIG_DFL),
    )


@contextmanager
def progress(total: int) -> Iterator[Callable[[int, str], None]]:
    """Show a bar on a terminal, nothing in a pipe.

    Yields:
        Takes how many more of the total are done, and what is to be said about it.
    """
    columns = (*Progress.get_default_columns(), MofNCompleteColumn())
    console = Console(stderr=True)
    with Progress(
        *columns, console=console, transient=True, disable=not console.is_terminal
    ) as bar:
        task = bar.add_task("", total=total)
        yield lambda count, what: bar.update(task, advance=count, description=what)
