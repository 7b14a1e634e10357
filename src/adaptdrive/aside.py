"""Calls that may hang, each in a separate thread.

The helper threads of the event loop are few, everything else that blocks needs them, and the
process cannot end before they do: a call to a name server or to a broken device takes minutes.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from threading import Thread
from typing import TypeVar

Result = TypeVar("Result")


def in_thread(call: Callable[[], Result], name: str) -> Future[Result]:
    """Start a call in a separate thread, for which the process need not wait.

    Args:
        call: What is called.
        name: Name of the thread.

    Returns:
        The result of the call, or the exception that it raised. It cannot be cancelled.
    """
    future: Future[Result] = Future()
    future.set_running_or_notify_cancel()  # whoever gives up cannot cancel it any more

    def run() -> None:
        try:
            result = call()
        except Exception as problem:  # noqa: BLE001 - passed to the caller
            future.set_exception(problem)
        else:
            future.set_result(result)

    Thread(target=run, name=name, daemon=True).start()
    return future
