"""The simulated drive as a CiA 402 node on CANopen, with its state machine.

One controlword makes one transition. A fault is left by an edge of bit 7 only, and only when its
cause is gone.

It serves its object dictionary over SDO, obeys NMT, sends heartbeats, emergencies and the PDOs that
it has been given. Where object 0x1005 is set so, it sends SYNC at the line's zero crossings. It
draws line current in *switched on* and feeds the load in *operation enabled* only, and it watches
the host's heartbeat: when that stays away it switches off by itself.
"""

import asyncio
import math
import struct
from collections.abc import Callable
from enum import IntEnum
from pathlib import Path

import can

from adaptdrive.config.bus import COMMANDED, CanOpenBus
from adaptdrive.config.root import Configuration
from adaptdrive.devices.can.bus import describe_bus, open_bus
from adaptdrive.devices.can.connection import FrameReader
from adaptdrive.devices.canopen.port import mapped
from adaptdrive.util.errors import BusError
from adaptdrive_sim.devices import canopen_objects
from adaptdrive_sim.devices.can import send
from adaptdrive_sim.devices.drive import QUANTITIES, DriveNode, Frame, SimulatedDrive

# The state machine of CiA 402 as a drive runs it: controlwords in, statusword out.

_SWITCH_ON, _ENABLE_VOLTAGE, _NO_QUICK_STOP, _ENABLE, _RESET = 0x01, 0x02, 0x04, 0x08, 0x80


class PowerState(IntEnum):
    """States by their statusword; bit 4 means that the line current may flow."""

    SWITCH_ON_DISABLED = 0x0040
    READY = 0x0021
    SWITCHED_ON = 0x0033
    ENABLED = 0x0037
    FAULT = 0x0008


def next_state(state: PowerState, word: int) -> PowerState:
    """Return the state after a controlword, of a drive without a fault."""
    if not word & _ENABLE_VOLTAGE or not word & _NO_QUICK_STOP:
        return PowerState.SWITCH_ON_DISABLED
    if not word & _SWITCH_ON:
        return PowerState.READY
    if state is PowerState.SWITCH_ON_DISABLED:
        return state
    if state is PowerState.READY or not word & _ENABLE:
        return PowerState.SWITCHED_ON
    return PowerState.ENABLED


# The simulated drive as a CiA 402 node on CANopen.

_NMT, _SYNC = 0x000, 0x080
_CONTROLWORD, _STATUSWORD = (0x6040, 0), (0x6041, 0)
_SYNC_ID, _CONSUMED, _PRODUCED = (0x1005, 0), (0x1016, 1), (0x1017, 0)
_REGISTER, _ERROR, _ABORT = (0x1001, 0), (0x603F, 0), (0x6007, 0)
_PRODUCES_SYNC = 1 << 30
_FAULT_ON_ABORT = 1

_NO_ERROR, _HEARTBEAT_LOST = 0x0000, 0x8130
_GENERIC, _COMMUNICATION = 0x01, 0x10
_CODES = {1: 0x2310, 2: 0x4310, 4: 0x3210, 8: 0x3130, 16: 0x5440, 32: 0x5110, 64: 0x6100}
"""Error codes by the bits of the drive's fault word."""


class _Nmt(IntEnum):
    """State of the node, as in its heartbeat."""

    BOOT_UP = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


_ORDERS = {0x01: _Nmt.OPERATIONAL, 0x02: _Nmt.STOPPED, 0x80: _Nmt.PRE_OPERATIONAL}
_RESETS = frozenset({0x81, 0x82})


class CanOpenDrive(DriveNode):
    """One simulated drive on one bus."""

    def __init__(self, drive: SimulatedDrive, configuration: Configuration, source: Path) -> None:
        """Build the node; nothing is opened yet.

        Raises:
            ConfigurationError: EDS and configuration do not fit together.
        """
        super().__init__(drive)
        assert isinstance(configuration.bus, CanOpenBus)  # noqa: S101 - `KINDS` has looked
        self._config = configuration.bus
        mapping = mapped(configuration, source)
        shown = {one.quantity: one for one in mapping.sources}
        self._shown = {name: shown[name] for name in QUANTITIES if name in shown}
        taken = (one for order in mapping.orders for one in order.parts.values())
        self._obeyed = [one for one in taken if one.name in COMMANDED]
        self._wire = canopen_objects.NodeNetwork(self._put)
        eds, node_id = str(self._config.eds), self._config.node_id
        self._objects = canopen_objects.Objects(eds, node_id, self._wire)
        self._power, self._reset = PowerState.SWITCH_ON_DISABLED, False
        self._nmt = _Nmt.BOOT_UP
        self._beat_s = -math.inf
        self._host_s: float | None = None
        self._bus: can.BusABC | None = None

    async def run(self, opened: Callable[[str], None]) -> None:
        """Open the bus, pass its description to `opened`, and serve it until cancelled.

        Raises:
            BusError: The bus cannot be opened, or is lost.
        """
        with open_bus(self._config) as self._bus:
            opened(describe_bus(self._config))
            self._boot()
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(self._receive(self._bus))
                tasks.create_task(self._run_half_cycles(self._half_cycle))

    def take(self, frame: can.Message) -> None:
        """Take one frame from the bus."""
        if frame.is_extended_id or frame.is_remote_frame or frame.is_error_frame:
            return
        can_id, data = frame.arbitration_id, bytes(frame.data)
        if can_id == _NMT:
            self._take_nmt(data)
        elif can_id == _SYNC:
            self._measure()
        elif can_id == 0x700 + self._watched[0]:
            self._take_heartbeat()
        elif can_id == 0x600 + self._config.node_id:
            if self._nmt is not _Nmt.STOPPED:
                self._wire.notify(can_id, bytearray(data), 0.0)
        elif self._nmt is _Nmt.OPERATIONAL and self._objects.take_pdo(can_id, data):
            self._follow_controlword()

    def take_garbage(self) -> None:
        """Count what is no frame."""
        self.counts["garbage"] += 1

    @property
    def _watched(self) -> tuple[int, float]:
        """Monitored node, and the longest time between two of its heartbeats; 0 for none."""
        entry = int(self._objects.number(_CONSUMED))
        return entry >> 16 & 0x7F, (entry & 0xFFFF) * 1e-3

    async def _receive(self, bus: can.BusABC) -> None:
        raise BusError(describe_bus(self._config), await FrameReader(bus, self).run())

    def _boot(self) -> None:
        """Start as after power-on."""
        self._objects.reset()
        self._power, self._reset = PowerState.SWITCH_ON_DISABLED, False
        self._host_s = None
        self._drive.shut_down("restart")
        self._put(0x700 + self._config.node_id, bytes((_Nmt.BOOT_UP,)))
        self._nmt = _Nmt.PRE_OPERATIONAL
        self._report("boot-up", node=self._config.node_id)

    def _take_nmt(self, data: bytes) -> None:
        if len(data) != 2 or data[1] not in {0, self._config.node_id}:
            return
        if data[0] in _RESETS:
            self._boot()
            return
        self._nmt = _ORDERS.get(data[0], self._nmt)
        if self._nmt is not _Nmt.OPERATIONAL:
            self._switch_off("not operational")
        self._send_heartbeat()

    def _take_heartbeat(self) -> None:
        if self._host_s is None and self._objects.number(_REGISTER) == _COMMUNICATION:
            self._emergency(_NO_ERROR, 0)
        self._host_s = self._clock()

    def _follow_controlword(self) -> None:
        """Follow the controlword, and pass to the power stage what the state lets through."""
        before, word = self._power, int(self._objects.number(_CONTROLWORD))
        edge, self._reset = bool(word & _RESET) and not self._reset, bool(word & _RESET)
        if before is not PowerState.FAULT:
            self._power = next_state(before, word)
        elif edge and not self._drive.fault:
            self._power = PowerState.SWITCH_ON_DISABLED
        state = self._power
        if before is not state:
            self._report("power state", state=state.name)
            if before is PowerState.FAULT:
                self._emergency(_NO_ERROR, 0)
        values = dict.fromkeys(COMMANDED, 0.0)
        if state in {PowerState.SWITCHED_ON, PowerState.ENABLED}:
            for one in self._obeyed:
                values[one.name] = (self._objects.number(one.item.address) - one.base) / one.factor
        self._obey(values | {"bridge": state is PowerState.ENABLED})

    def _half_cycle(self, frame: Frame) -> None:
        """Carry out one zero crossing of the line."""
        quantities = frame.quantities()
        for name, source in self._shown.items():
            shown = (quantities[name] - source.offset) / source.scale
            self._objects.put(source.item.address, shown % 65536 if name == "counter" else shown)
        self._watch_host()
        self._watch_fault(frame.fault)
        if self._clock() - self._beat_s >= self._objects.number(_PRODUCED) * 1e-3 > 0.0:
            self._send_heartbeat()
        if int(self._objects.number(_SYNC_ID)) & _PRODUCES_SYNC and self._nmt >= _Nmt.OPERATIONAL:
            self._put(_SYNC, b"")
            self._measure()

    def _measure(self) -> None:
        """Send the PDOs that follow SYNC."""
        if self._nmt is not _Nmt.OPERATIONAL:
            return
        self._objects.put(_STATUSWORD, self._power)
        for can_id, data in self._objects.transmit_pdos():
            self._put(can_id, data)

    def _watch_host(self) -> None:
        """Switch off when the host's heartbeat has stayed away for too long."""
        timeout_s = self._watched[1]
        if self._host_s is None or not timeout_s:
            return
        silent_s = self._clock() - self._host_s
        if silent_s <= timeout_s:
            return
        self._host_s = None
        self._nmt = _Nmt.PRE_OPERATIONAL
        if self._objects.number(_ABORT) == _FAULT_ON_ABORT:
            self._power = PowerState.FAULT
        self._switch_off("heartbeat lost", silent_s)
        self._emergency(_HEARTBEAT_LOST, _COMMUNICATION)

    def _watch_fault(self, fault: int) -> None:
        if not fault or self._power is PowerState.FAULT:
            return
        self._power = PowerState.FAULT
        self._drive.shut_down("fault")
        self._emergency(_CODES[fault & -fault], _GENERIC)

    def _switch_off(self, reason: str, after_s: float = 0.0) -> None:
        if self._power is not PowerState.FAULT:
            self._power = PowerState.SWITCH_ON_DISABLED
        self._drive.shut_down(reason, after_s)

    def _emergency(self, code: int, register: int) -> None:
        self._objects.put(_REGISTER, register)
        self._objects.put(_ERROR, code)
        self._put(0x080 + self._config.node_id, struct.pack("<HB5x", code, register))
        self._report("emergency", code=code)

    def _send_heartbeat(self) -> None:
        self._beat_s = self._clock()
        self._put(0x700 + self._config.node_id, bytes((self._nmt,)))

    def _put(self, can_id: int, data: bytes) -> None:
        frame = can.Message(arbitration_id=can_id, is_extended_id=False, data=data)
        self.counts["sent" if send(self._bus, frame) else "dropped"] += 1
