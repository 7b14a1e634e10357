"""The command `adaptdrive`: one clear line for every error, and a status that scripts can use."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from adaptdrive.cli import standard_files
from adaptdrive.util.errors import AdaptdriveError, ConfigurationError

INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        arguments: Words after the program's name; those of this process when None.

    Returns:
        The exit status: 0 done or accepted, 1 failed or refused, 2 unusable arguments or
        configuration, 3 no answer, 4 the end of a session is not recorded, 130 interrupted.
    """
    standard_files.heed_signals()
    words = sys.argv[1:] if arguments is None else list(arguments)
    return carry_out("adaptdrive", _daemon(words) or _understood(words), words)


def carry_out(
    program: str,
    command: Callable[[], object],
    arguments: Sequence[str],
    unusable: int = standard_files.UNUSABLE,
) -> int:
    """Run one command of a program, and return its exit status.

    Args:
        program: Its name, which begins each line about an error.
        command: The command, which may return a status.
        arguments: Words after the program's name.
        unusable: Status where its configuration cannot be used.
    """
    standard_files.open_standard_files()
    standard_files.lay_out_help(arguments)
    try:
        outcome = command()
    except AdaptdriveError as problem:
        configured = isinstance(problem, ConfigurationError)
        return standard_files.complain(
            program, str(problem), unusable if configured else standard_files.FAILED
        )
    except KeyboardInterrupt:
        return INTERRUPTED
    except SystemExit as end:
        if not standard_files.reader_has_ended(end):
            raise
        return 0
    except OSError as problem:
        return standard_files.unwritten(problem, program)
    return standard_files.flushed(outcome if isinstance(outcome, int) else 0, program)


def _daemon(words: Sequence[str]) -> Callable[[], object] | None:
    """Return the daemon for `run FILE`, which starts without what understands other words."""
    match words:
        case ["run", file] if not file.startswith("-"):
            from adaptdrive.cli.run import run  # noqa: PLC0415 - see above

            return lambda: run(Path(file))
    return None


def _understood(words: Sequence[str]) -> Callable[[], object]:
    from adaptdrive.cli.commands import build_app, understood  # noqa: PLC0415 - see above

    return understood(build_app(), words)
