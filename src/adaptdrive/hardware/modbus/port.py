"""Port of a drive on Modbus: polls it on an absolute grid, and writes the newest command.

A poll that gives every value makes one reading, as old as the first of its requests; one that does
not gives none, so that the values in use grow old until they trip the drive. A drive at rest has a
reading of the old values then, with its bridge, so that it can confirm its stop. A command waits
for the end of the poll under way, the safe command only for the end of the exchange under way.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace

from adaptdrive.config.modbus import ModbusRtu, ModbusTcp, RtuLink
from adaptdrive.control.signals import Command
from adaptdrive.errors import BusError
from adaptdrive.hardware.backoff import BusBackoff
from adaptdrive.hardware.fault_latch import FaultLatch
from adaptdrive.hardware.modbus.blocks import Block
from adaptdrive.hardware.modbus.bus import describe_bus
from adaptdrive.hardware.modbus.capacity import Exchange
from adaptdrive.hardware.modbus.commander import Commander
from adaptdrive.hardware.modbus.link import ExchangeError, ModbusConnection
from adaptdrive.hardware.modbus.mapping import HEARTBEAT, Poll
from adaptdrive.hardware.modbus.replies import are_alike
from adaptdrive.hardware.modbus.serial_port import SerialPort
from adaptdrive.hardware.port import Listener, PortStatistics, Reading

_SILENT_POLLS = 3
"""Polls without a reading after which the drive is reported lost."""

_MIXED_UP = (
    "replies come that nothing asked for, and one read of this map may be taken for the next: two "
    "devices with the same id, or a line that repeats"
)


class ModbusPort:
    """One connection to one drive on Modbus."""

    counter_modulus = None
    """A poll is no frame of the drive: its counter cannot be the time base."""

    def __init__(
        self,
        config: ModbusTcp | ModbusRtu,
        poll: Poll,
        poll_s: float,
        clock: Callable[[], float],
    ) -> None:
        self._config = config
        self._serial = SerialPort(config) if isinstance(config, RtuLink) else None
        self._poll = poll
        self._poll_s = poll_s
        self._clock = clock
        self._counts: Counter[str] = Counter()
        self._commander = Commander(poll, poll_s, self._counts, clock)
        self._listener: Listener | None = None
        self._link: ModbusConnection | None = None
        self._wake = asyncio.Event()
        self._closing = False
        self._faults = FaultLatch()
        self._heartbeat: float | None = None
        self._heartbeat_s = -math.inf
        self._handed_out: Reading | None = None
        self._silent = 0
        self._foreign = 0
        reads = [one for one in poll.exchanges() if one.read is not None]
        self._alike = are_alike(config, reads)
        self._up = True
        self._raw: dict[Block, list[int]] = {}
        self._failure = ""

    @property
    def description(self) -> str:
        """The bus in one phrase, such as `modbus-tcp 10.0.0.7:502 device 1`."""
        return describe_bus(self._config)

    @property
    def statistics(self) -> PortStatistics:
        """Counts since the port was built."""
        return PortStatistics(**self._counts)

    @property
    def complaint(self) -> str | None:
        """Reason not to energise the drive: it does not accept its commands, or had a fault."""
        return self._commander.complaint or self._faults.complaint

    @property
    def safe_s(self) -> float:
        """Time at which the drive acknowledged the safe command, infinite without one in force."""
        return self._commander.safe_s

    @property
    def stop_slack_s(self) -> float | None:
        """Nothing, or None for a drive whose map has no register for its bridge."""
        sources = [source for _, each in self._poll.reads for source in each]
        return 0.0 if any(source.quantity == "bridge" for source in sources) else None

    async def run(self, listener: Listener, opened: Callable[[], None]) -> None:
        """Open the link, call `opened`, and poll until cancelled; reconnect when it is lost.

        A drive on TCP that is not there yet is waited for, like one that is switched off.

        Args:
            listener: Receiver of readings and of the state of the bus.
            opened: Called once, when the port is ready.

        Raises:
            BusError: The serial port cannot be opened at the first attempt.
        """
        self._listener = listener
        link, problem = await self._try_first()
        opened()
        worker = asyncio.create_task(self._work(link, problem), name="modbus")
        try:
            await asyncio.shield(worker)
        finally:
            # an exchange on a serial line is never cut short, and the drive is left in its safe
            # state, before the line is closed
            self._closing = True
            self._wake.set()
            await worker

    def send(self, command: Command) -> bool:
        """Give the drive a command with the next exchange; a later one takes its place.

        Args:
            command: Command to the drive; it must have passed the guard.

        Returns:
            Whether there is a link to send it on; False is counted.

        Raises:
            ValueError: A value is not finite, or its register cannot hold it.
        """
        self._commander.set(command)
        if self._link is None:
            self._counts["send_drops"] += 1
            return False
        if self._commander.urgent:
            self._wake.set()
        return True

    def catch_up(self) -> None:
        """A reply is handed over by the task that polls, and only one is ever awaited."""

    def rehearse(self) -> None:
        """A drive that is polled has time."""

    def explain_age(self) -> str:
        """Return the missing registers of the last poll; every value is as old as its poll."""
        none = "no reply has come since the last reading" if self._raw else "no reply has come yet"
        return f"the polls give no reading: {self._failure or none}"

    def details(self) -> list[str]:
        """The registers of the last poll, raw, and what was refused."""
        read = [
            f"registers {block} = [{' '.join(f'{word:04x}' for word in words)}]"
            for block, words in self._raw.items()
        ]
        problems = (self._failure, self._commander.refused_write)
        return [*read, *(f"refused: {one}" for one in problems if one)]

    async def reset_fault(self) -> None:
        """No-op: a register map has no fault reset; the drive clears its fault word by itself."""

    async def _try_first(self) -> tuple[ModbusConnection | None, str]:
        try:
            return await self._open(), ""
        except BusError as problem:
            if isinstance(self._config, ModbusRtu):
                raise
            return None, problem.problem

    async def _open(self) -> ModbusConnection:
        link = ModbusConnection(self._config, self._counts, self._clock, serial=self._serial)
        await link.open()
        return link

    async def _work(self, link: ModbusConnection | None, problem: str) -> None:
        """Serve one link after the other until the port is closed."""
        backoff = BusBackoff(lambda: self._counts["received"])
        while link is not None or not self._closing:
            if link is None:
                self._report_down(problem)
                self._wake.clear()  # what was urgent when the link was lost does not hurry it back
                await self._sleep(backoff.next_s())
                link = None if self._closing else await self._reopen()
                continue
            problem = await self._serve(link)
            link = None

    async def _reopen(self) -> ModbusConnection | None:
        with contextlib.suppress(BusError):
            link = await self._open()
            self._counts["reconnects"] += 1
            return link
        return None

    async def _serve(self, link: ModbusConnection) -> str:
        """Poll over an open link until it is lost or the port is closed; why it was lost."""
        self._link, self._heartbeat, self._heartbeat_s = link, None, -math.inf
        self._handed_out = None
        self._commander.begin()
        next_s = self._clock()
        try:
            while link.lost is None and not self._closing:
                self._commander.note_step()
                await self._poll_once(link)
                next_s = self._next(next_s)
                await self._idle(link, next_s)
            await self._commander.leave_safe(link)
        except Exception:
            with contextlib.suppress(Exception):  # the first problem counts
                await self._commander.leave_safe(link)
            raise
        finally:
            self._link = None
            link.close()
        return link.lost or "closed"

    def _next(self, last_s: float) -> float:
        """The next point of the grid that is still to come."""
        late = max(0.0, self._clock() - last_s)
        return last_s + (1 + int(late / self._poll_s)) * self._poll_s

    async def _idle(self, link: ModbusConnection, until_s: float) -> None:
        """Wait for the next poll; a safe command goes out at once."""
        while link.lost is None and not self._closing and self._clock() < until_s:
            self._wake.clear()
            if self._commander.urgent:
                await self._commander.write(link)
            await self._sleep(until_s - self._clock())

    async def _sleep(self, seconds: float) -> None:
        """Sleep, unless the port is closed or a command is urgent."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(max(0.0, seconds)):
                await self._wake.wait()

    async def _poll_once(self, link: ModbusConnection) -> None:
        """Read all registers, pass the reading on, and write the resulting command."""
        start_s = self._clock()
        known, self._foreign = self._foreign, self._counts["foreign"]
        try:
            values = await self._read(link)
        except ExchangeError as failure:
            self._failure = failure.problem
            self._commander.note_read(answered=False)
            self._note_silence(failure.problem)
        else:
            self._commander.note_read(answered=True)
            if self._alike and self._counts["foreign"] > known:  # since the last poll began
                self._failure = _MIXED_UP
            else:
                self._take(values, start_s)
        if link.lost is None and self._commander.pending:
            await self._commander.write(link)

    async def _read(self, link: ModbusConnection) -> dict[str, float | None]:
        """Return every quantity, None for each that must not be used.

        Raises:
            ExchangeError: The drive did not give one of the blocks.
        """
        values: dict[str, float | None] = {}
        refused: list[str] = []
        for number, (block, sources) in enumerate(self._poll.reads):
            if self._commander.urgent:
                await self._commander.write(link)
            words = await self._commander.read(link, Exchange(read=block), first=number == 0)
            self._raw[block] = words
            found = {source.quantity: source.value(block, words) for source in sources}
            self._faults.see(found.get("fault"))
            values |= found
            bad = (source for source in sources if found[source.quantity] is None)
            refused += (source.explain(block, words) for source in bad)
        more = f", and {len(refused) - 1} more" if len(refused) > 1 else ""
        self._failure = f"{refused[0]}{more}" if refused else ""
        self._counts["out_of_range"] += bool(refused)
        return values

    def _take(self, values: Mapping[str, float | None], start_s: float) -> None:
        """Hand out the reading of a poll, unless it has none or the drive stands still."""
        good = {name: value for name, value in values.items() if value is not None}
        if not self._is_alive(good.get(HEARTBEAT), start_s):
            return
        whole = len(good) == len(values)
        reading = self._compose(good, start_s) if whole else self._compose_stop(start_s)
        if reading is None:
            return
        self._report_up()
        self._commander.note_bridge(powered=reading.bridge)
        if self._listener is not None:
            self._faults.clear(reading.fault)
            self._handed_out = reading
            self._listener.on_reading(reading)

    def _compose(self, values: Mapping[str, float], start_s: float) -> Reading:
        """Return the reading of a poll that gave every value."""
        counter, bridge = values.get("counter"), values.get("bridge")
        return Reading(
            arrival_s=self._clock(),
            oldest_s=start_s,
            counter=None if counter is None else int(counter),
            boost_voltage_V=values.get("boost_voltage_V", math.nan),
            line_voltage_V=values.get("line_voltage_V", math.nan),
            load_power_W=values.get("load_power_W", math.nan),
            output=values.get("output", math.nan),
            fault=self._faults.word,
            # a drive without a bridge signal is assumed to follow the last command
            bridge=self._commander.bridge if bridge is None else bridge != 0,
            other={name: values[name] for name in self._poll.other},
        )

    def _compose_stop(self, start_s: float) -> Reading | None:
        """Return the last reading with the bridge of a poll with refused values.

        None for a driven drive: one at rest alone may confirm its stop without measurements.
        """
        last, bridge = self._handed_out, self._find_bridge()
        if last is None or bridge is None or self._commander.safe_s == math.inf:
            return None
        return replace(
            last,
            arrival_s=self._clock(),
            counter=None,
            fault=self._faults.word,
            bridge=bridge != 0,
            bridge_s=start_s,
        )

    def _find_bridge(self) -> float | None:
        """Return the bridge of a poll with refused values, None for one that is not to be used."""
        for block, sources in self._poll.reads:
            for source in sources:
                if source.quantity == "bridge":
                    return source.word(block, self._raw[block])
        return None

    def _is_alive(self, heartbeat: float | None, now_s: float) -> bool:
        if self._config.heartbeat.drive is None:
            return True
        known, self._heartbeat = self._heartbeat, heartbeat
        if known is None:
            return False  # one value alone shows no life, and neither does the same one again
        if heartbeat != known:
            self._heartbeat_s = now_s
            return True
        patience_s = self._config.heartbeat.drive_timeout_s or 0.0
        if now_s - self._heartbeat_s <= patience_s:
            return True
        self._counts["counter_stuck"] += 1
        self._failure = "the drive's heartbeat register stands still: its controller hangs"
        return False

    def _note_silence(self, problem: str) -> None:
        self._silent += 1
        if self._silent >= _SILENT_POLLS:
            self._report_down(problem)

    def _report_up(self) -> None:
        self._silent = 0
        if not self._up and self._listener is not None:
            self._up = True
            self._listener.on_bus(up=True, detail=self.description)

    def _report_down(self, problem: str) -> None:
        if self._up and self._listener is not None:
            self._up = False
            self._listener.on_bus(up=False, detail=f"{self.description}: {problem}")
