"""The Python interface: recorded sessions, their loads, simulations, and running drives over MQTT.

`docs/python.md` shows it at work. All but `connect` needs the extra `adaptdrive[analysis]`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from adaptdrive.config import Configuration, load_configuration
from adaptdrive.connected import ConnectedDrive
from adaptdrive.control.signals import Estimate, Mode
from adaptdrive.mqtt.connection import Broker
from adaptdrive.recording.session import SessionInfo
from adaptdrive.util.errors import ConfigurationError

if TYPE_CHECKING:  # they need libraries that `connect` does without
    from adaptdrive.analysis.closed_loop import Plant, Simulation
    from adaptdrive.analysis.model import Model
    from adaptdrive.analysis.record import RecordLoad
    from adaptdrive.commissioning.evaluation import Commissioned


@dataclass(frozen=True, slots=True)
class Tables:
    """A recorded session as tables.

    Attributes:
        info: Contents of `session.json`.
        ticks: Fast ticks.
        slow: Slow steps; a column for each estimate, its deviation (`…_std`) and each gain.
        sensors: Values of the sensor buses.
        events: Events.
        commands: Operator commands.
        units: Unit of each column that has one, by name.
        path: Its folder.
    """

    info: SessionInfo
    ticks: Any
    slow: Any
    sensors: Any
    events: Any
    commands: Any
    units: dict[str, str]
    path: Path


def load_session(path: str | Path) -> Tables:
    """Load a recorded session, or the record of a trip, into memory.

    Args:
        path: Its folder.

    Raises:
        AdaptdriveError: There is no session, or it is damaged. Damaged events are a warning:
            the tables of its events and commands lack them.
        ModuleNotFoundError: The library is not installed.
    """
    from adaptdrive.analysis.export import session_frames  # noqa: PLC0415 - `connect` needs none

    return Tables(**session_frames(Path(path)), path=Path(path))


def identify(
    source: Any,  # noqa: ANN401 - tables of several libraries
    begin_s: float | None = None,
    end_s: float | None = None,
    **options: Any,  # noqa: ANN401 - each as `RecordView` declares it
) -> RecordLoad:
    """Identify the load from a record, in open or closed loop.

    Args:
        source: A session (its folder, or its tables from `load_session`), a `Simulation`, a CSV
            file, or a table with named columns: of polars, pandas or pyarrow, or arrays by name.
        begin_s: First second used, from the start of the record on; None for the first.
        end_s: Last second used, None for the last.
        options: How a file or a table is read; what is left out is guessed. `input`, `output`,
            `time`, `sample_time_s`, `before`, `lags` and `config` are those of `RecordView` in
            `analysis.record`.

    Raises:
        AdaptdriveError: The record cannot be read, or does not show its load.
        ModuleNotFoundError: A library is not installed.
    """
    from adaptdrive.analysis import record  # noqa: PLC0415 - `connect` needs none

    view = record.RecordView(begin_s=begin_s, end_s=end_s, **options)
    return record.identify_source(source.path if isinstance(source, Tables) else source, view)


def model(
    source: str | Path | Configuration | Tables | ConnectedDrive,
    begin_s: float | None = None,
    end_s: float | None = None,
    config: str | Path | Configuration | None = None,
) -> Model:
    """Return the model of a load, and the loop that its controller closes.

    The numbers are attributes; `.control("loop")` is a transfer function of python-control,
    `.scipy("load")` one of scipy, `.margins` has the margins of the loop.

    Args:
        source: A session (its folder, or its tables): the identified load, and the last recorded
            gains. A configuration, or its file: its model, and the fixed controller. A drive from
            `connect`: its present estimates and gains.
        begin_s: First second of a session that is used, None for the first.
        end_s: Last second that is used, None for the last.
        config: For a drive its configuration, or that file: no message has the delays of the loop.

    Raises:
        AdaptdriveError: The source cannot be read, a session does not show its load, or a drive
            does not answer or run.
        ModuleNotFoundError: A library is not installed.
    """
    from adaptdrive.analysis import model as models  # noqa: PLC0415 - `connect` needs none

    if isinstance(source, ConnectedDrive):
        if config is None:
            raise ConfigurationError.of("model", "config", "is needed for a drive: name its file")
        estimates = {name: Estimate(float(one), one.std) for name, one in source.estimates.items()}
        return models.model_of_estimates(_configuration(config), estimates, source.gains)
    found = source.path if isinstance(source, Tables) else source
    if isinstance(found, Configuration) or Path(found).is_file():
        return models.model_of_configuration(_configuration(found))
    return models.model_of_session(Path(found), begin_s, end_s)


def simulate(
    config: str | Path | Configuration,
    plant: Plant,
    setpoint: float | Callable[[float], float],
    duration_s: float,
    mode: Literal["fixed", "adaptive"] = "adaptive",
) -> Simulation:
    """Run the daemon's controller on a plant of your own, in virtual time.

    Args:
        config: The configuration, or its file.
        plant: An object with `step(boost_voltage_V, duration_s)`, which returns the output and the
            power drawn from the boost capacitor in W; with `step_s` where its own step differs from
            the time between two readings of the drive.
        setpoint: A constant, or the set-point at each time in s.
        duration_s: Simulated time, in s.
        mode: Controller asked for.

    Raises:
        ConfigurationError: The configuration is not valid.
        IdentificationError: A set-point, or a value that the plant returns, is not finite.
        ModuleNotFoundError: A library is not installed.
    """
    from adaptdrive.analysis import closed_loop  # noqa: PLC0415 - see above

    whole = _configuration(config)
    wanted = setpoint if callable(setpoint) else lambda _: setpoint
    course = closed_loop.setpoints(whole, wanted, duration_s, Mode(mode))
    return closed_loop.simulate(whole, plant, course)


def _configuration(config: str | Path | Configuration) -> Configuration:
    return config if isinstance(config, Configuration) else load_configuration(Path(config))


def commission(
    config: str | Path, plant: Plant, move: float = 0.05, patience_s: float | None = None
) -> Commissioned:
    """Find the model and the settings for a plant of your own, as `adaptdrive commission` does.

    `found.proposal.configuration` is for `simulate`; `found.proposal.model` has the parameters.

    Args:
        config: File with the configuration, whose `[load.model]` may be wrong.
        plant: As for `simulate`.
        move: Movement of the output, as a share of the set-point range.
        patience_s: Shortest wait for a response; that of the kind of load when None.

    Raises:
        AdaptdriveError: The configuration is not valid, or the load cannot be found; the reason is
            the message.
        ModuleNotFoundError: A library is not installed.
    """
    from adaptdrive.commissioning.run import commission_plant  # noqa: PLC0415 - see above

    return commission_plant(Path(config), plant, move, patience_s)


def connect(name: str, broker: Broker | None = None, timeout_s: float = 5.0) -> ConnectedDrive:
    """Connect to a running drive, for a shell, a notebook or a plain script.

    Args:
        name: Name of the drive.
        broker: The broker; port 1883 of this machine when None.
        timeout_s: Longest wait for the drive, and for each reply.

    Raises:
        NoAnswerError: The broker or the daemon does not answer.
    """
    return ConnectedDrive(name, broker or Broker(), timeout_s)
