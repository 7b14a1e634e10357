"""What each port promises of its drive, in the same words for every bus."""

from __future__ import annotations

import asyncio
import math
from itertools import groupby

import pytest

from adaptdrive.control.signals import SAFE_COMMAND, Command
from tests.contracts.port.rig import CHARGE, RUN, Build, Rig
from tests.unit.devices.bench import until


async def test_a_reading_holds_what_the_drive_measured_and_when(rig: Rig) -> None:
    known = len(rig.ear.readings)
    await rig.hears(5)
    for reading in rig.ear.readings[known:]:
        assert reading.boost_voltage_V == pytest.approx(rig.voltage_V)
        assert (reading.fault, reading.bridge, reading.whole) == (0, False, True)
        assert rig.now_s - 7.0 * rig.cycle_s < reading.oldest_s <= reading.arrival_s <= rig.now_s
        assert reading.oldest_s <= reading.bridge_reported_s <= reading.arrival_s
    arrivals_s = [reading.arrival_s for reading in rig.ear.readings]
    assert arrivals_s == sorted(set(arrivals_s))
    assert rig.port.trip_cause is None


async def test_whoever_only_listens_commands_nothing(rig: Rig) -> None:
    await rig.hears(20)
    assert rig.heard == []
    assert not (rig.watched and rig.fed_s)
    assert rig.port.monitor.safe_s == math.inf


async def test_the_newest_command_reaches_the_drive(rig: Rig) -> None:
    for voltage_V in (250.0, 260.0, 287.65):
        assert rig.port.send(Command(0.0, voltage_V, bridge=False))
    await until(lambda: bool(rig.heard) and math.isclose(rig.heard[-1][1], 287.65, abs_tol=0.01))
    await until(lambda: rig.port.statistics.sent >= 1)
    assert rig.port.statistics.send_drops == 0


@pytest.mark.parametrize("voltage_V", [math.nan, math.inf])
async def test_an_impossible_command_is_not_sent(rig: Rig, voltage_V: float) -> None:
    with pytest.raises(ValueError, match=r"outside|cannot hold"):
        rig.port.send(Command(0.0, voltage_V, bridge=True))
    await rig.passes(10)
    assert rig.heard == []


async def test_a_drive_is_brought_up_and_down_again(rig: Rig) -> None:
    await rig.runs()
    assert rig.heard[-1][0]
    assert rig.heard[-1][1] == pytest.approx(287.65, abs=0.01)
    assert rig.port.monitor.safe_s == math.inf
    rig.ear.command = SAFE_COMMAND
    await until(lambda: not rig.latest.bridge)
    assert rig.heard[-1] == (False, 0.0)
    assert rig.port.monitor.safe_s <= rig.latest.bridge_reported_s
    assert rig.port.trip_cause is None
    safe_s = rig.port.monitor.safe_s
    await rig.hears(5)
    assert rig.port.monitor.safe_s == safe_s  # it is that of the first of several
    rig.ear.command = CHARGE
    await rig.hears(2)
    assert rig.port.monitor.safe_s == math.inf


async def test_a_stop_is_confirmed_by_a_report_of_the_bridge_alone(rig: Rig) -> None:
    await rig.runs()
    rig.obeys, rig.ear.command = False, SAFE_COMMAND
    await until(lambda: rig.port.monitor.safe_s < math.inf)
    known = len(rig.ear.readings)
    await rig.hears(5)
    assert all(reading.bridge for reading in rig.ear.readings[known:])
    rig.bridge = False
    await until(lambda: not rig.latest.bridge)
    assert rig.latest.bridge_reported_s > rig.port.monitor.safe_s


async def test_a_safe_command_that_is_refused_is_not_in_force(rig: Rig) -> None:
    await rig.runs()
    rig.refuses, rig.ear.command = True, SAFE_COMMAND
    known = len(rig.fed_s)
    await rig.passes(8)
    assert rig.port.monitor.safe_s == math.inf
    assert rig.heard[-1][0]
    if rig.watched:  # nothing feeds it, and the operator is told
        assert len(rig.fed_s) <= known + 1
        assert rig.port.trip_cause is not None
    rig.refuses = False
    await until(lambda: rig.port.monitor.safe_s < math.inf and rig.port.trip_cause is None)
    assert rig.heard[-1] == (False, 0.0)


async def test_a_value_that_is_refused_makes_no_reading_newer(rig: Rig) -> None:
    await rig.hears(2)
    rig.spoilt = True
    await rig.passes(2)
    good, known = rig.latest, len(rig.ear.readings)
    await rig.passes(8)
    for reading in rig.ear.readings[known:]:
        assert (reading.boost_voltage_V, reading.whole) == (good.boost_voltage_V, False)
        assert reading.oldest_s == good.oldest_s
    assert rig.port.explain_age()
    rig.spoilt = False
    await until(lambda: rig.latest.oldest_s > good.oldest_s)
    assert rig.latest.whole


async def test_a_stop_is_confirmed_beside_values_that_are_refused(rig: Rig) -> None:
    await rig.runs()
    rig.spoilt, rig.ear.command = True, SAFE_COMMAND
    await rig.passes(1)
    rig.port.send(SAFE_COMMAND)
    await until(lambda: not rig.latest.bridge)
    assert rig.port.monitor.safe_s <= rig.latest.bridge_reported_s
    assert rig.latest.boost_voltage_V == pytest.approx(rig.voltage_V)


async def test_a_fault_of_one_report_is_not_forgotten(rig: Rig) -> None:
    await rig.hears(2)
    rig.show_fault()
    await until(lambda: rig.ear.readings[-1].fault != 0 or rig.port.trip_cause is not None)


async def test_a_silent_drive_makes_no_readings_and_is_heard_again(rig: Rig) -> None:
    await rig.hears(2)
    rig.silent = True
    await rig.passes(3)
    known = len(rig.ear.readings)
    await rig.passes(12)
    assert len(rig.ear.readings) == known
    assert rig.port.explain_age()
    rig.silent = False
    await rig.hears(3)
    assert rig.ear.readings[known].oldest_s > rig.ear.readings[known - 1].arrival_s


async def test_a_drive_that_does_not_obey_is_left_to_its_own_watchdog(rig: Rig) -> None:
    if not rig.watched:
        pytest.skip("no frame feeds it")
    await rig.runs()
    rig.obeys, rig.ear.command = False, SAFE_COMMAND
    await rig.passes(2)
    assert await rig.hungry_s(4.0) >= rig.starved_s
    rig.bridge = False
    await until(lambda: not rig.latest.bridge)
    assert await rig.hungry_s(2.0) < 0.5 * rig.starved_s


async def test_a_drive_whose_stop_may_take_long_is_fed_meanwhile(build: Build) -> None:
    """Its own watchdog would end a stop as a fault."""
    async with build(5.0) as rig:
        if not rig.watched:
            pytest.skip("no frame feeds it")
        await rig.runs()
        rig.obeys, rig.ear.command = False, SAFE_COMMAND
        assert await rig.hungry_s(4.0) < 0.5 * rig.starved_s


async def test_a_lost_bus_takes_no_command_and_is_reported_once(rig: Rig) -> None:
    await rig.runs()
    known = len(rig.ear.bus)
    await rig.is_lost()
    assert rig.port.description in rig.ear.bus[known][1]
    assert not rig.port.send(RUN)
    assert not rig.port.send(SAFE_COMMAND)
    await asyncio.sleep(10.0)
    assert [up for up, _ in rig.ear.bus[known:]] == [False]
    assert rig.port.explain_age()
    await rig.is_back()
    await rig.hears(3)
    assert [up for up, _ in groupby(rig.ear.bus[known:], lambda told: told[0])] == [False, True]
    assert rig.port.statistics.reconnects >= 1


async def test_a_command_from_before_a_loss_is_never_delivered_after_it(rig: Rig) -> None:
    await rig.runs()
    rig.ear.command = None
    await rig.is_lost()
    known = len(rig.heard)
    assert not rig.port.send(Command(0.0, 260.0, bridge=True))
    await rig.is_back()
    await rig.passes(20)
    driven = {voltage_V for bridge, voltage_V in rig.heard[known:] if bridge}
    assert driven == ({260.0} if rig.keeps_newest else set())


async def test_a_safe_command_from_before_a_loss_is_not_in_force_after_it(rig: Rig) -> None:
    """The drive may have started anew, or have heard another sender."""
    await rig.runs()
    rig.obeys, rig.ear.command = False, SAFE_COMMAND
    await until(lambda: rig.port.monitor.safe_s < math.inf)
    rig.ear.command = None
    await rig.is_lost()
    lost_s = rig.now_s
    await rig.is_back()
    await rig.hears(2)
    assert rig.port.monitor.safe_s > lost_s
    assert rig.port.send(SAFE_COMMAND)
    await until(lambda: rig.port.monitor.safe_s < math.inf)


async def test_a_drive_that_stopped_during_a_loss_is_not_driven_on(rig: Rig) -> None:
    await rig.runs()
    await rig.is_lost()
    rig.bridge = False
    known = len(rig.heard)
    await rig.is_back()
    await until(lambda: rig.port.monitor.stop is not None)
    await rig.passes(20)
    assert rig.port.monitor.stop is not None
    assert not [one for one in rig.heard[known:] if one[0]]
    rig.ear.command = SAFE_COMMAND
    await until(lambda: rig.port.trip_cause is None)
    await rig.runs()


async def test_a_drive_that_stayed_on_during_a_loss_is_driven_on_where_its_bus_permits_it(
    rig: Rig,
) -> None:
    await rig.runs()
    await rig.is_lost()
    known = len(rig.heard)
    await rig.is_back()
    await rig.passes(20)
    assert any(bridge for bridge, _ in rig.heard[known:]) == rig.outlives_loss
    assert (rig.port.trip_cause is None) == rig.outlives_loss


async def test_an_error_of_the_listener_ends_the_port_and_leaves_the_drive_safe(rig: Rig) -> None:
    await rig.runs()
    rig.ear.fails = True
    assert rig.task is not None
    with pytest.raises((ZeroDivisionError, ExceptionGroup)):
        await rig.task
    await until(lambda: rig.heard[-1] == (False, 0.0))
    assert not rig.port.send(RUN)
