"""The command `adaptdrive`: one clear line for every error, and a status that scripts can use."""

import codecs
import errno
import gc
import os
import re
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from io import FileIO, TextIOWrapper
from pathlib import Path
from typing import Literal, TextIO

from adaptdrive import __version__, build_name
from adaptdrive.util.errors import AdaptdriveError, ConfigurationError

INTERRUPTED = 130
FAILED, UNUSABLE = 1, 2
"""Exit status of a command that could not do what it was asked for, or not use what it got."""

_UNWRITTEN = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EPIPE, errno.EBADF}
_INPUT, _OUTPUT, _ERRORS = range(3)
_FEWEST_COLUMNS = 20
_HELP = {"--help", "-h"}
_ESCAPES = "adaptdrive-escapes"
_THREAD_PATIENCE_S = 0.5


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        arguments: Words after the program's name; those of this process when None.

    Returns:
        The exit status: 0 done or accepted, 1 failed or refused, 2 unusable arguments or
        configuration, 3 no answer, 4 the end of a session is not recorded, 130 interrupted.
    """
    unblock_signals()
    words = sys.argv[1:] if arguments is None else list(arguments)
    return carry_out("adaptdrive", _command(words), words)


def carry_out(
    program: str,
    command: Callable[[], object],
    arguments: Sequence[str],
    unusable: int = UNUSABLE,
) -> int:
    """Run one command of a program, and return its exit status.

    Args:
        program: Its name, which begins each line about an error.
        command: The command, which may return a status.
        arguments: Words after the program's name.
        unusable: Status where its configuration cannot be used.
    """
    open_standard_files()
    lay_out_help(arguments)
    try:
        outcome = command()
    except AdaptdriveError as problem:
        configured = isinstance(problem, ConfigurationError)
        return print_error(program, str(problem), unusable if configured else FAILED)
    except KeyboardInterrupt:
        return INTERRUPTED
    except SystemExit as end:
        # rich, which prints help and tables, ends the program because nothing reads: what it
        # prints has been done, or nothing has, and the status of the command stays as it was
        if not isinstance(end.__context__, BrokenPipeError):
            raise
        return 0
    except OSError as problem:
        return unwritten(problem, program)
    return flushed(outcome if isinstance(outcome, int) else 0, program)


def _command(words: Sequence[str]) -> Callable[[], object]:
    """Return what the words ask for; some start without what understands other words."""
    match words:
        case ["--version"]:
            return lambda: print(version())
        case ["run", file] if not file.startswith("-"):
            return lambda: run(Path(file))
    from adaptdrive.cli.options import build_app, parsed_command  # noqa: PLC0415 - see above

    return parsed_command(build_app(), words)


def version() -> str:
    """Return the version of this program, and how it was built."""
    return f"{__version__} ({build_name()})"


def run(config: Path, /) -> int:
    """Run the daemon for one drive until a signal stops it.

    Args:
        config: Configuration file.

    Returns:
        Exit status.
    """
    gc.disable()  # a fifth of the start would go to looking through what imports make, which stays
    from adaptdrive.app.run import run as run_drive  # noqa: PLC0415 - see above

    gc.freeze()  # without this the next collection would look through all of it
    gc.enable()
    status = run_drive(config)
    _leave_stuck_threads(status)
    return status


def _leave_stuck_threads(status: int) -> None:
    """End the process at once while a thread waits for the disk, which would hold up its end."""
    deadline_s = time.monotonic() + _THREAD_PATIENCE_S
    others = [one for one in threading.enumerate() if one is not threading.current_thread()]
    for thread in others:
        if not thread.daemon:
            thread.join(max(0.0, deadline_s - time.monotonic()))
            if thread.is_alive():
                os._exit(status)


# Signals and standard files as a process needs them, whatever its starter has left.


def open_standard_files() -> None:
    """Open the null device in place of each standard file that is closed.

    Otherwise a bus or a database would get that number, and what other code prints would end in it.
    """
    for number in (_INPUT, _OUTPUT, _ERRORS):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the kernel gives the lowest free number
    sys.stdin = sys.stdin or _stream(_INPUT, "r")
    sys.stdout = sys.stdout or _stream(_OUTPUT, "w")
    sys.stderr = sys.stderr or _stream(_ERRORS, "w")
    if isinstance(getattr(sys.stdout, "buffer", None), FileIO) and not sys.stdout.isatty():
        # unbuffered: a reader that has had enough would end the command before its end
        sys.stdout = _stream(_OUTPUT, "w", sys.stdout.encoding, sys.stdout.errors)
    if isinstance(sys.stdout, TextIOWrapper) and _refuses_letters(sys.stdout):
        # Latin-1 has no "…": what a terminal cannot show is escaped, as it is on standard error
        codecs.register_error(_ESCAPES, _escaped)
        sys.stdout.reconfigure(errors=_ESCAPES)


def lay_out_help(arguments: Sequence[str]) -> None:
    """Have help laid out for so many columns at least that the layout of its tables ends.

    Args:
        arguments: Words after the program's name.
    """
    given = os.environ.get("COLUMNS", "")
    columns = int(given[:6]) if given.isdecimal() else shutil.get_terminal_size().columns
    if columns < _FEWEST_COLUMNS and not _HELP.isdisjoint(arguments or ["--help"]):
        os.environ["COLUMNS"] = str(_FEWEST_COLUMNS)


def discard_output() -> None:
    """Discard output that nothing takes, which would be an error at the exit of Python."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def flushed(status: int, program: str) -> int:
    """Return the status of a command that has ended, once its output is written.

    A reader that has ended changes no status: the drive did what the status says.

    Args:
        status: Its status.
        program: Name of the program.
    """
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        discard_output()
    except OSError as problem:
        discard_output()
        text = f"standard output cannot be written: {problem.strerror}"
        ended = f"the command itself ended with status {status}"
        return print_error(program, f"{text}; {ended}", status or FAILED)
    return status


def unwritten(problem: OSError, program: str) -> int:
    """Return the status of a command that could not write its output or reach a file.

    What is neither is an internal error and raised again. An error of a file names it.

    Args:
        problem: What the command ended with.
        program: Name of the program.
    """
    if problem.filename is None and problem.errno not in _UNWRITTEN:
        raise problem
    discard_output()
    if isinstance(problem, BrokenPipeError):
        return FAILED
    if problem.filename is not None:
        return print_error(program, str(problem), FAILED)
    text = f"standard output cannot be written: {problem.strerror}"
    return print_error(program, f"{text}; the command ended early", FAILED)


def print_error(program: str, text: str, status: int) -> int:
    """Print a text to standard error without the numbers of the system's errors; return a status.

    Args:
        program: Name of the program, which begins each line.
        text: One or more lines.
        status: The status.
    """
    for line in re.sub(r"\[Errno -?\d+\] ", "", text).splitlines():
        print(f"{program}: {line}", file=sys.stderr)
    return status


def _refuses_letters(stream: TextIO) -> bool:
    """Return whether a letter that its encoding lacks is an error, as in the C locale."""
    lacks_some = codecs.lookup(stream.encoding).name != "utf-8"
    return stream.errors == "strict" or (lacks_some and stream.errors == "surrogateescape")


def _escaped(problem: UnicodeError) -> tuple[str | bytes, int]:
    """Return the byte that a letter of a path stands for, an escape for any other letter."""
    assert isinstance(problem, UnicodeEncodeError)  # noqa: S101 - what is printed is encoded
    problem.end = problem.start + 1
    kept = "\udc80" <= problem.object[problem.start] <= "\udcff"
    return codecs.lookup_error("surrogateescape" if kept else "backslashreplace")(problem)


def _stream(
    number: int, mode: Literal["r", "w"], encoding: str = "utf-8", errors: str | None = None
) -> TextIO:
    return open(number, mode, encoding=encoding, errors=errors, closefd=False)


def unblock_signals() -> None:
    """Unblock every signal, and have ended child processes reported.

    A process inherits both from the program that starts it. With SIGTERM blocked nothing but
    SIGKILL would end a daemon, and a drive would stay on; with SIGCHLD ignored the status of a
    recorder that has ended is lost. A signal that was ignored on purpose, as by `nohup`, stays so.
    """
    signal.pthread_sigmask(signal.SIG_UNBLOCK, signal.valid_signals())
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
