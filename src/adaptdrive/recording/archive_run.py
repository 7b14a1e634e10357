"""The archiver as the control process sees it: started in a thread, heard line by line."""

from __future__ import annotations

import asyncio
import contextlib
import subprocess
from collections.abc import Callable, Sequence

import msgspec

from adaptdrive.aside import in_thread
from adaptdrive.recording.records import News
from adaptdrive.runtime.reports import Severity


async def run_archiver(
    command: Sequence[str],
    report: Callable[[Severity, str], None],
    start_thread: Callable[[], None],
) -> str:
    """Run the archiver until it ends; it continues where this is cancelled.

    Args:
        command: Program and words.
        report: Takes its events, in the event loop.
        start_thread: What a thread does first.

    Returns:
        Why it failed, empty where it did not.
    """
    loop = asyncio.get_running_loop()

    def tell(news: News) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended
            loop.call_soon_threadsafe(report, Severity(news.severity), news.detail)

    def run() -> str:
        start_thread()
        return _run(command, tell)

    try:
        return await asyncio.wrap_future(in_thread(run, "archiver"))
    except (OSError, RuntimeError) as problem:  # no further process or thread
        return str(problem)


def _run(command: Sequence[str], tell: Callable[[News], None]) -> str:
    with subprocess.Popen(  # noqa: S603 - this program itself
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        # Ctrl-C on the terminal is for the control process
        start_new_session=True,
    ) as process:
        for line in process.stdout or ():
            with contextlib.suppress(msgspec.DecodeError):
                tell(msgspec.json.decode(line, type=News))
        said = b"" if process.stderr is None else process.stderr.read()
    if process.returncode == 0:
        return ""
    lines = said.decode(errors="replace").strip().splitlines()
    return lines[-1] if lines else f"the archiver ended with status {process.returncode}"
