"""The `[bus]` and `[signals]` of a drive, from its DBC or EDS and the choices of its user."""

from collections.abc import Iterable, Iterator, Mapping

from cantools.database.can.database import Database
from cantools.database.can.message import Message

from adaptdrive.app.starter import quoted
from adaptdrive.devices.can.database import cycle_time_s
from adaptdrive.devices.can.kind import proofs
from adaptdrive.devices.description import Candidate

Choices = Mapping[str, Candidate | None]
"""The chosen signal of each quantity, by its key in `[signals]`; None for no such signal."""

_HALF_CYCLES_PER_S = 120.0
_SI_UNITS = ("", "V", "A", "W", "K", "rad/s", "S")
_OPTIONAL = ("counter", "fault", "bridge", "command.current_scale_S")

_MEASURED = "\n# Confirm each line with the manual of the drive.\n[signals]\n"
_CAN = """\
[bus]
type = "can"
interface = "socketcan"
channel = "can0"
database = {database}
clock = "{clock}"  # its arrival is the tick
clock_ticks = {ticks}  # half line cycles from one such message to the next
# command_timeout_s = 0.1  # the drive's own: it opens its bridge without commands
"""
_PROOF = """
# Proposed by the names of the signals: compare form and covered bytes with the manual.
[bus.integrity.{message}]
"""
_CANOPEN = """\
[bus]
type = "canopen"
interface = "socketcan"
channel = "can0"
eds = {eds}
node_id = 1  # of the drive
own_node_id = 127  # of the daemon, whose heartbeat the drive watches
sync = "daemon"
"""


def can_part(database: Database, name: str, choices: Choices) -> str:
    """Return `[bus]` to `[voltage_loop]` of a drive that a DBC describes.

    Args:
        database: The DBC.
        name: Its path as the configuration is to name it.
        choices: The chosen signals.
    """
    chosen = [one for one in choices.values() if one is not None]
    messages = {one.reference.partition(".")[0]: None for one in chosen}
    used = [database.get_message_by_name(message) for message in messages]
    output = choices.get("output") or choices.get("boost_voltage_V")
    clock = output.reference.partition(".")[0] if output else ""  # its arrival is the tick
    cycle_s = next((cycle_time_s(one) for one in used if one.name == clock), 0.0)
    ticks = max(1, round(cycle_s * _HALF_CYCLES_PER_S))
    head = _CAN.format(database=quoted(name), clock=clock, ticks=ticks)
    return "".join([head, *_proofs(used), *_signals(choices)])


def canopen_part(eds: str, choices: Choices) -> str:
    """Return `[bus]` to `[voltage_loop]` of a drive that an EDS describes.

    Args:
        eds: Path of the EDS as the configuration is to name it.
        choices: The chosen objects.
    """
    return "".join([_CANOPEN.format(eds=quoted(eds)), *_signals(choices)])


def _proofs(used: Iterable[Message]) -> Iterator[str]:
    for message in used:
        counter, checksum = proofs(message)
        if counter or checksum:
            yield _PROOF.format(message=message.name)
        if counter:
            yield f'counter = "{counter}"\n'
        if checksum:
            yield f'checksum = "{checksum}"\n'


def _signals(choices: Choices) -> Iterator[str]:
    for head, commands in ((_MEASURED, False), ("\n[signals.command]\n", True)):
        yield head
        for quantity, chosen in choices.items():
            if quantity.startswith("command.") is commands:
                yield _line(quantity, chosen)
    where = "daemon" if choices.get("command.current_scale_S") else "drive"
    yield f'\n[voltage_loop]\nwhere = "{where}"\n\n'


def _line(quantity: str, chosen: Candidate | None) -> str:
    key = quantity.removeprefix("command.")
    if chosen is None:
        remark = "leave out where the drive has none" if quantity in _OPTIONAL else "needed"
        return f'# {key} = "…"  # nothing like it was found: {remark}\n'
    if quantity.endswith("bridge") and chosen.on:
        states = f"on = {quoted(chosen.on)}"
        if chosen.off and quantity == "command.bridge":
            states += f", off = {quoted(chosen.off)}"
        return f'{key} = {{ signal = "{chosen.reference}", {states} }}\n'
    about = ", ".join(part for part in (chosen.unit, chosen.range) if part)
    remark = f"  # {about}" if about else ""
    if chosen.unit in _SI_UNITS:
        return f'{key} = "{chosen.reference}"{remark}\n'
    return f'{key} = {{ signal = "{chosen.reference}", unit = {quoted(chosen.unit)} }}{remark}\n'
