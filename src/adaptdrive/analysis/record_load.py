"""The load that any record shows."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from adaptdrive.analysis.record import InputOutputRecord
from adaptdrive.app.loads import build_load, candidate_loads
from adaptdrive.config import Configuration
from adaptdrive.control.load import Load
from adaptdrive.control.loads.bath import bath_load
from adaptdrive.control.loads.motor import motor_load
from adaptdrive.control.signals import Estimate
from adaptdrive.errors import IdentificationError
from adaptdrive.identification.identify import FEWEST_IN_PART, identify_any
from adaptdrive.identification.proposal import proposed_model, time_constants
from adaptdrive.identification.result import IdentifiedLoad

_MOST_BLOCKS = 4000


@dataclass(frozen=True, slots=True)
class RecordLoad:
    """The load of a record.

    Attributes:
        name: Of the record.
        unit: Of the output; empty where it is not known.
        ends_s: Time at the end of the last block of each part of the record.
        load: The identified load.
        online: Last estimates of the daemon; empty where there are none.
        nominal: Parameters of the configured model; empty where there is none.
        model: Keys of `[load.model]`; gain and time constants without a configuration.
    """

    name: str
    unit: str
    ends_s: tuple[float, ...]
    load: IdentifiedLoad
    online: dict[str, Estimate]
    nominal: dict[str, float]
    model: dict[str, Estimate]


def identify_record(
    record: InputOutputRecord,
    name: str,
    configuration: Configuration | None = None,
    lags: int | None = None,
) -> RecordLoad:
    """Identify the load of a record.

    Args:
        record: The record.
        name: Its name.
        configuration: That of the drive whose boost voltage and output it has; None for any input.
        lags: Lags of the load; where None, two if the record shows a second one.

    Raises:
        IdentificationError: The record does not show its load.
    """
    block = math.ceil(sum(len(one.output) for one in record.excerpts) / _MOST_BLOCKS)
    record = record.without_short(FEWEST_IN_PART * block)
    ends_s = tuple(
        begin_s + len(one.output) // block * block * one.period_s
        for begin_s, one in zip(record.begins_s, record.excerpts, strict=True)
    )
    if configuration is None:
        load = _plain(record, block, lags)
        return RecordLoad(name, "", ends_s, load, {}, {}, time_constants(load))
    if lags is not None:
        raise IdentificationError("lags and a configuration were given: it says how many there are")
    structure = build_load(configuration)
    load = identify_any(record.excerpts, candidate_loads(configuration), block=block)
    nominal = structure.physical(list(structure.numerator), list(structure.denominator))
    return RecordLoad(
        name=name,
        unit=configuration.load.output_unit,
        ends_s=ends_s,
        load=load,
        online={},
        nominal=dict(zip(structure.names, nominal, strict=True)),
        model=proposed_model(load, configuration.load),
    )


def _plain(record: InputOutputRecord, block: int, lags: int | None) -> IdentifiedLoad:
    """Return the load between any input and output with the lags that the record shows."""
    counts = (1, 2) if lags is None else (lags,)
    return identify_any(record.excerpts, [plain_load(count) for count in counts], block=block)


def plain_load(lags: int) -> Load:
    """Return the structure of a load whose input is measured.

    Raises:
        IdentificationError: It is of no order that can be identified.
    """
    if lags == 1:
        bath = bath_load(1.0, 1.0, 1.0, 0.0, 1.0)
        return replace(bath, input_gain=1.0, input_exponent=1, names=("gain", "tau_s"))
    if lags != 2:
        raise IdentificationError(f"{lags} lags: a load has one or two")
    return motor_load(1.0, 1.0, 1.0)
