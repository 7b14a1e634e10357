"""The long forms of the tests, each as a command of the interpreter.

SEEDS, STORIES, CONFIGURATIONS, EXAMPLES, INPUTS, MUTANTS, KILLS, DAYS and MINUTES of the
environment make some of them shorter or longer; AT_MOST is the real time in minutes after which
the virtual days end.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field

from tests.integration.faults.rows import GROUPS
from tools.mutation.targets import MQTT, PARTS, RUNTIME


@dataclass(frozen=True, slots=True)
class Form:
    """A long form.

    Attributes:
        name: Names it on the command line and its result.
        title: Its section of the page.
        command: Arguments of the interpreter.
        environment: What makes it long.
        as_table: Whether its output is Markdown already.
        is_shown: Whether the page shows its output, not only that it passed.
    """

    name: str
    title: str
    command: tuple[str, ...]
    environment: dict[str, str] = field(default_factory=dict)
    as_table: bool = False
    is_shown: bool = True

    @property
    def shown_command(self) -> str:
        """What to type to repeat it."""
        settings = "".join(f"{name}={value} " for name, value in self.environment.items())
        return f"{settings}python {' '.join(self.command)}"


def forms() -> tuple[Form, ...]:
    """Return all forms, as long as the environment has them."""
    seeds = os.environ.get("SEEDS", "20")
    stories = os.environ.get("STORIES", "5000")
    inputs = os.environ.get("INPUTS", "1000000")
    fewer = {"MUTANTS": os.environ["MUTANTS"]} if "MUTANTS" in os.environ else {}
    mutants = os.environ.get("MUTANTS", "25")
    days, minutes = os.environ.get("DAYS", "7"), os.environ.get("MINUTES", "120")
    kills = os.environ.get("KILLS", "200")
    at_most = ("--at-most", os.environ["AT_MOST"]) if "AT_MOST" in os.environ else ()
    whole, faults = ("-m", "pytest", "-q"), "tests/integration/faults"
    drawn = (*whole, f"{faults}/test_configurations.py", "--timeout", "86400")
    energised = (*whole, f"{faults}/test_energised.py", "--timeout", "86400")
    examples = os.environ.get("EXAMPLES", "1000")
    # By files: what a module builds once, as the Debian package, is built once.
    parallel = ("--numprocesses", "2", "--dist", "loadfile", "--timeout", "86400")
    long = (*whole, "-m", "proof", *parallel)
    properties = (*whole, "-m", "hypothesis", *parallel)
    return (
        *(Form(group, f"Faults: {group}", ("-m", "tools.proof.faults", seeds, group),
               as_table=True, is_shown=False) for group in GROUPS),
        Form("stories", "Stories that must energise nothing", energised, {"STORIES": stories},
             is_shown=False),
        Form("configurations", "Configurations of any valid values", drawn,
             {"CONFIGURATIONS": os.environ.get("CONFIGURATIONS", "500")}, is_shown=False),
        Form("long", "More seeds, patterns and loads of the tests", long, is_shown=False),
        Form("properties", "Properties of drawn values", properties, {"EXAMPLES": examples},
             is_shown=False),
        Form("inputs", "Damaged inputs of each decoder", ("-m", "tools.fuzz", inputs)),
        Form("foreign", "A drive of foreign code", (*whole, "tests/peers"),
             is_shown=False),
        Form("deceived", "Sensors that lie", ("-m", "tools.proof.deceived", seeds),
             as_table=True),
        Form("kills", "Processes killed at random moments",
             ("-m", "tools.benchmarks", "--only", "kills"), {"KILLS": kills}),
        Form("measurements", "Long measurements", ("-m", "tools.benchmarks"), is_shown=False),
        Form("soak-virtual", "Days of operators and faults in virtual time",
             ("-m", "tools.soak", "virtual", days, *at_most), as_table=True),
        Form("soak-real", "A site in real time at 120 Hz",
             ("-m", "tools.soak", "real", minutes), as_table=True),
        Form("faults-by-hand", "Faults put by hand into safety code",
             ("-m", "tools.mutation.faults"), is_shown=False),
        *(Form(f"mutants-{module.rpartition('.')[2]}", f"Small changes of the code: {module}",
               ("-m", "tools.mutation", module.removeprefix("adaptdrive.")), fewer, as_table=True)
          for module in RUNTIME | MQTT),
        *(Form(f"mutants-{part}", f"Small changes of the code: {part}",
               ("-m", "tools.mutation", part), {"MUTANTS": mutants}, as_table=True)
          for part in PARTS),
        *(Form(f"branches-{package}", f"Lines and branches: {package}",
               ("-m", "tools.branches", package), as_table=True)
          for package in ("runtime", "mqtt", "control")),
    )  # fmt: skip
