"""The words of a command line, and the commands that they name."""

from collections.abc import Callable, Sequence

from cyclopts import App, CycloptsError, UnknownCommandError, UnusedCliTokensError

from adaptdrive import __version__
from adaptdrive.cli import UNUSABLE, print_error
from adaptdrive.runtime.requests import REQUESTS

_COMMANDS = {
    "init": ("configuration", "Write a first configuration for a load and a bus."),
    "start": ("desk", "Run a drive on a desk: its daemon, a broker, the panel, and the view."),
    "run": ("run", "Run the daemon for one drive until a signal stops it."),
    "check": ("configuration", "Validate a configuration; list every error with its place."),
    "schema": ("configuration", "Print the JSON Schema of the configuration, for editors."),
    "probe": ("probe", "Show decoded measurements from the bus; command nothing."),
    "replay": ("sessions", "Run the controller again on a recorded session."),
    "events": ("sessions", "Show the events of a recorded session."),
    "plot": ("analysis", "Draw a recorded session: a figure, and a report as one HTML file."),
    "identify": ("analysis", "Identify the load from a session or a CSV file, with error bars."),
    "whatif": ("analysis", "Run a session again in closed loop with other settings."),
    "export": ("analysis", "Write a session as CSV, Parquet, MATLAB, MDF 4 or MCAP."),
    "commission": ("analysis", "Measure an unknown load on its drive, and propose the settings."),
    "panel": ("desk", "Serve the panel, a web page for a broker's drives, on this machine."),
    "watch": ("operate", "Show a drive live in the terminal, with keys for the commands."),
    "status": ("operate", "Show the state and the telemetry of a drive."),
    "manual": ("operate", "Hold the present V_c until the command voltage."),
}

# Where an argument may be left out: cyclopts calls it [ARGS] in the first line of --help.
_ARGUMENTS = {"start": "[CONFIG]", "waveform": "DRIVE SHAPE [LOW HIGH PERIOD]"} | dict.fromkeys(
    ("replay", "events", "plot", "identify", "whatif"), "[SESSION]"
)

_LIST = "List the drives of a broker."
_SESSIONS = "List, show, verify and prune recorded sessions."


def parsed_command(app: App, words: Sequence[str] | None = None) -> Callable[[], object]:
    """Return what carries out the command that words name, or tells what is wrong with them.

    Args:
        app: The commands of a program.
        words: Words after its name; those of this process when None.
    """

    def carry_out() -> object:
        try:
            return app(words)
        except CycloptsError as problem:
            program = app.name[0]
            return print_error(program, _usage_error(program, problem), UNUSABLE)

    return carry_out


def _usage_error(program: str, problem: CycloptsError) -> str:
    """Return what is wrong with the words of a command."""
    words = " ".join(problem.unused_tokens or ())
    if isinstance(problem, UnknownCommandError):
        from adaptdrive.util.errors import nearest  # noqa: PLC0415 - no command needs it

        hint = nearest(words.split(" ")[0], [*_COMMANDS, *REQUESTS, "list", "sessions"])
        return f"unknown command {words!r}{hint}; see {program} --help"
    if isinstance(problem, UnusedCliTokensError):
        return f"the command takes no {words!r}; see its --help"
    return " ".join(str(problem).split())


def _version() -> str:
    from adaptdrive.pure import build_name  # noqa: PLC0415 - it imports the controller

    return f"{__version__} ({build_name()})"


def build_app() -> App:
    """Return the commands of `adaptdrive`."""
    app = App(
        name="adaptdrive",
        help="Adaptive control of speed, temperature and charge behind a power-electronic drive.",
        version=_version,
        print_error=False,
        exit_on_error=False,
        suppress_keyboard_interrupt=False,
        result_action="return_value",
    )
    for name, (module, purpose) in _COMMANDS.items():
        # By name, so that a command imports what it needs and no other command does.
        path = f"adaptdrive.cli.{module}:{name}"
        app.command(path, name=name, help=purpose, usage=_usage(name))
    for verb, request in REQUESTS.items():
        path = f"adaptdrive.cli.operate:{verb}"
        purpose = (request.__doc__ or "").partition("\n")[0]
        app.command(path, name=verb, help=purpose, usage=_usage(verb))
    app.command("adaptdrive.cli.operate:list_drives", name="list", help=_LIST)
    app.command("adaptdrive.cli.sessions:app", name="sessions", help=_SESSIONS)
    app.register_install_completion_command(
        add_to_startup=False, help="Install completion for the present shell."
    )
    return app


def _usage(command: str) -> str | None:
    arguments = _ARGUMENTS.get(command)
    return arguments and f"Usage: adaptdrive {command} [OPTIONS] {arguments}"
