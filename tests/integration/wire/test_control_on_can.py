"""What the daemon does with its controller over a real bus, in virtual time."""

from __future__ import annotations

import asyncio
import cmath
import tomllib
from collections.abc import Mapping
from contextlib import AbstractAsyncContextManager
from itertools import pairwise
from typing import Any

import pytest

from adaptdrive.config import Configuration
from adaptdrive.config.file import validate_configuration
from adaptdrive.control.signals import Mode, Shape, Waveform
from adaptdrive.runtime.reports import Event, LoadReport, State, TickReport
from adaptdrive.runtime.requests import Disable, Enable, Reset, SetMode, SetSetpoint, SetWaveform
from adaptdrive.util.errors import RefusedError
from adaptdrive_sim.device import DeviceSettings
from tests.integration.closed_loop.wire import WAIT_s, Wire, wired
from tests.integration.wire.rig import EXAMPLES, rigged, until

Changes = Mapping[str, Mapping[str, Any]]

AT_280_V = DeviceSettings(initial_voltage_V=280.0)
QUICK: Changes = {
    "load": {"period_s": 0.25, "samples": 22},
    "load.model": {"tau_motor_s": 2.925, "tau_filter_s": 2.5},
    "estimator": {"tau_lambda_s": 2.5, "settle_s": 0.5},
    "supervisor": {"warm_up_s": 4.0},
}
"""A quarter of the example's inertia, controlled four times as fast."""


def described(port: int, changes: Changes, example: str = "motor") -> Configuration:
    """An example on a port of its own, changed by section and key."""
    path = EXAMPLES / f"{example}.toml"
    tables: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
    common: Changes = {"bus": {"udp_port": port}}
    for section, values in [*common.items(), *changes.items()]:
        place = tables
        for name in section.split("."):
            place = place.setdefault(name, {})
        place.update(values)
    return validate_configuration(tables, path)


def on_can(
    port: int, changes: Changes, settings: DeviceSettings = AT_280_V, example: str = "motor"
) -> AbstractAsyncContextManager[Wire]:
    """The daemon and its plant."""
    return wired(described(port, changes, example), settings, EXAMPLES / f"{example}.toml")


async def periods(wire: Wire, count: int) -> list[LoadReport]:
    return [await wire.period() for _ in range(count)]


async def tripped(wire: Wire) -> str:
    """Wait for a trip; its cause."""
    await until(lambda: wire.state is State.TRIPPED, poll_s=0.05)
    return "" if wire.daemon._machine.trip is None else wire.daemon._machine.trip.text


async def test_power_returns_to_the_line_within_its_limit(free_udp_port: int) -> None:
    changes = {"drive.limits": {"regeneration_scale_max_S": 0.003}}
    settings = DeviceSettings(initial_voltage_V=390.0)
    async with on_can(free_udp_port, changes, settings, "motor-bidirectional") as wire:
        ticks = wire.hub.subscribe(TickReport, size=10_000)
        await wire.until_running()
        for setpoint, count in ((4.2, 8), (2.6, 12)):
            await wire.daemon.execute(SetSetpoint(setpoint))
            await periods(wire, count)
        used = [one for one in ticks.drain() if isinstance(one, TickReport)]
        assert wire.state is State.RUNNING
    scales = [one.command.current_scale_S for one in used]
    assert min(scales) == pytest.approx(-0.003, rel=0.01)
    assert scales.count(min(scales)) > 12
    assert min(one.measurement.load_power_W for one in used) < -20.0
    assert max(one.measurement.boost_voltage_V for one in used) < 430.0


async def test_switching_controllers_makes_no_bump(free_udp_port: int) -> None:
    async with on_can(free_udp_port, QUICK) as wire:
        await wire.until_running()
        await wire.daemon.execute(SetWaveform(Waveform(Shape.SQUARE, 2.9, 3.2, 3.0)))
        await periods(wire, 80)
        await wire.daemon.execute(SetSetpoint(3.1))
        before = (await periods(wire, 20))[-1].decision
        for mode in (Mode.ADAPTIVE, Mode.FIXED):
            await wire.daemon.execute(SetMode(mode))
            while (after := (await wire.period()).decision).controller is not mode:
                before = after
            assert before.gains != after.gains
            assert abs(after.handover_step_V) < 1.0
            assert abs(after.boost_reference_V - before.boost_reference_V) < 1.0
            before = after


async def test_decisions_take_effect_at_their_fixed_tick(free_udp_port: int) -> None:
    async with on_can(free_udp_port, {}) as wire:
        ticks = wire.hub.subscribe(TickReport, size=10_000)
        await wire.until_running()
        await periods(wire, 12)
        used = [one for one in ticks.drain() if isinstance(one, TickReport)]
    delays = [one.measurement.tick - 120 * one.applied_k for one in used if one.applied_k >= 0]
    assert len(delays) >= 10
    assert set(delays) == {2}


POLE, PERIOD_S = 0.70, 1.0
NOMINAL = {"gain": 0.011, "tau_sum_s": 21.7, "tau_product_s2": 117.0}
PAPER: Changes = {
    "load": {"design": "paper", "boost_course": "impulse"},
    # None of these has a say in the paper's design: no estimate would pass.
    "supervisor": {
        "warm_up_s": 4.0,
        "ratio_min": 0.99,
        "ratio_max": 1.01,
    },
    "estimator": {"settle_s": 1000.0},
}


async def test_every_estimate_reaches_the_gains_by_the_published_formulas(
    free_udp_port: int,
) -> None:
    """`load.design = "paper"`: the daemon's gains are the paper's, and nothing is added."""
    async with on_can(free_udp_port, PAPER) as wire:
        ticks = wire.hub.subscribe(TickReport, size=10_000)
        await wire.daemon.execute(SetMode(Mode.ADAPTIVE))
        await wire.until_running()
        await wire.daemon.execute(SetWaveform(Waveform(Shape.SQUARE, 2.9, 3.2, 8.0)))
        decisions = [report.decision for report in await periods(wire, 40)]
        used = [one.command for one in ticks.drain() if isinstance(one, TickReport)]
    first = next(i for i, one in enumerate(decisions) if one.controller is Mode.ADAPTIVE)
    in_force = decisions[first:]
    assert len(in_force) >= 20
    assert all(one.controller is Mode.ADAPTIVE for one in in_force)
    accepted = [one for one in in_force if one.accepted]
    assert len(accepted) >= 10
    for one in accepted:
        found = {name: one.estimates[name].value for name in NOMINAL}
        r1, r2, h1, h2, h3, _ = one.gains
        assert [r1, r2] == pytest.approx(published(**found)[:2], rel=0.01, abs=0.005)
        assert [h1, h2, h3] == pytest.approx(published(**found)[2:], rel=0.05)
    assert max(distance(one.estimates) for one in accepted) > 0.01
    # the commanded voltage changes more than once in a slow period, within the limits
    voltages = [one.boost_reference_V for one in used[600:] if one.boost_reference_V > 0.0]
    changes = [after - before for before, after in pairwise(voltages) if after != before]
    assert len(changes) > 1.2 * len(voltages) / 120
    assert 200.0 <= min(voltages) < max(voltages) <= 400.0


def published(gain: float, tau_sum_s: float, tau_product_s2: float) -> list[float]:
    """(30), (25) and (28) with the published corrections, as coefficients of past values."""
    gap = cmath.sqrt(0.25 * tau_sum_s**2 - tau_product_s2)
    slow, fast = 0.5 * tau_sum_s + gap, 0.5 * tau_sum_s - gap
    left, right = cmath.exp(-PERIOD_S / slow), cmath.exp(-PERIOD_S / fast)
    a1, a2 = -(left + right).real, (left * right).real
    b1 = (PERIOD_S * gain * (left - right) / (slow - fast)).real
    x1, x2, x3, x4 = -4 * POLE, 6 * POLE**2, -4 * POLE**3, POLE**4
    d1 = x4 / a2
    h1 = (x1 + d1 - a1 + 1.0) / b1
    h2 = (x2 + d1 * (a1 - 1.0) + a1 - a2) / b1
    h3 = (x3 + d1 * (a2 - a1) + a2) / b1
    return [-(1.0 + d1), d1, h1, h2, h3]


def distance(estimates: Mapping[str, Any]) -> float:
    """Largest relative distance of an estimate from the nominal model."""
    return max(abs(float(estimates[name].value) / NOMINAL[name] - 1.0) for name in NOMINAL)


async def test_a_drive_that_holds_its_voltage_gets_v_c_alone(free_udp_port: int) -> None:
    settings = DeviceSettings(initial_voltage_V=260.0)
    changes = {**QUICK, "voltage_loop": {"where": "drive"}}
    async with on_can(free_udp_port, changes, settings) as wire:
        ticks = wire.hub.subscribe(TickReport, size=10_000)
        await wire.until_running()
        await wire.daemon.execute(SetSetpoint(3.1))
        report = (await periods(wire, 60))[-1]
        used = [one.command for one in ticks.drain() if isinstance(one, TickReport)]
        assert report.snapshot.output == pytest.approx(3.1, abs=0.03)
        applied_V = wire.world.boost.voltage_V
        assert applied_V == pytest.approx(report.decision.boost_reference_V, abs=3.0)
    assert any(one.bridge for one in used)
    assert {one.current_scale_S for one in used} == {0.0}


BOTH = {"enable_bit": "bridge-and-boost"}
NEEDS_BRIDGE = DeviceSettings(boost_needs_bridge=True)


@pytest.mark.parametrize("where", ["daemon", "drive"])
async def test_a_boost_stage_behind_the_enable_bit_starts(free_udp_port: int, where: str) -> None:
    changes: Changes = {"drive": BOTH, "voltage_loop": {"where": where}}
    async with on_can(free_udp_port, changes, NEEDS_BRIDGE) as wire:
        ticks = wire.hub.subscribe(TickReport, size=10_000)
        await asyncio.sleep(WAIT_s)
        assert not any(one.command.bridge for one in ticks.drain() if isinstance(one, TickReport))
        await wire.until_running()
        await wire.daemon.execute(SetSetpoint(3.0))
        await asyncio.sleep(3.0)
        assert wire.state is State.RUNNING
        assert wire.world.bridge
        await wire.daemon.execute(Disable())
        await until(lambda: wire.state is State.STANDBY)
        assert not wire.world.bridge


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"drive": BOTH, "drive.limits": {"current_scale_max_S": 3e-4}}, "with its enable bit on"),
        ({}, "drive.enable_bit = 'bridge-and-boost'"),
    ],
    ids=["power of 4 W", "without the key"],
)
async def test_a_boost_voltage_that_does_not_rise_trips(
    free_udp_port: int, changes: Changes, named: str
) -> None:
    limits = {"interlocks": {"precharge_timeout_s": 2.0}}
    async with on_can(free_udp_port, {**changes, **limits}, NEEDS_BRIDGE) as wire:
        await asyncio.sleep(WAIT_s)
        await wire.daemon.execute(Enable())
        await wire.daemon.execute(SetSetpoint(3.0))
        async with asyncio.timeout(4.0):
            trip = await tripped(wire)
        assert trip.startswith("precharge: v_bst = ")
        assert named in trip
        await asyncio.sleep(0.2)
        assert not wire.world.bridge


@pytest.mark.parametrize("share", [0.0, 0.2])
async def test_half_of_a_message_refused_is_reported_once_and_trips_beyond_a_share(
    free_udp_port: int, share: float
) -> None:
    """The drive's frames carry another data id than the daemon's description in turn."""
    integrity = {"data_id": 0x0102, "data_id_mode": "low"}
    changes: Changes = {
        "bus.integrity.DriveStatus": integrity,
        "interlocks": {"stale_s": 1.0, "refused_share": share},
    }
    of_drive: Changes = {"bus.integrity.DriveStatus": integrity | {"data_id_mode": "alternating"}}
    path = EXAMPLES / "motor.toml"
    daemon, drive = (described(free_udp_port, one) for one in (changes, of_drive))
    async with wired(daemon, AT_280_V, path, drive) as wire:
        events = wire.hub.subscribe(Event, size=1000)
        await wire.until_running()
        if share:
            trip = await tripped(wire)
            assert "refused frames: drive: 25%" in trip
            assert "limit 20%" in trip
            await asyncio.sleep(1.0)
            with pytest.raises(RefusedError, match="refused frames"):
                await wire.daemon.execute(Reset())
            return
        await asyncio.sleep(20.0)
        assert wire.state is State.RUNNING
        told = [one for one in events.drain() if isinstance(one, Event) and one.kind == "refused"]
    (only,) = told
    assert "wrong_checksum" in only.detail
    assert "data_id" in only.detail


async def test_two_daemons_trip_and_neither_enables(free_udp_port: int) -> None:
    configuration = described(free_udp_port, {})
    async with wired(configuration, AT_280_V, EXAMPLES / "motor.toml") as wire:
        await wire.until_running()
        async with rigged(configuration) as twin:
            trip = await tripped(wire)
            assert trip.startswith("another sender commands this drive: ")
            assert "0x080 (DriveCommand)" in trip
            await asyncio.sleep(1.0)
            for daemon in (wire.daemon, twin.daemon):
                with pytest.raises(RefusedError, match="another sender"):
                    await daemon.execute(Enable())
            with pytest.raises(RefusedError, match="another sender"):
                await wire.daemon.execute(Reset())
            assert not wire.world.bridge
        await asyncio.sleep(6.0)
        await wire.daemon.execute(Reset())
        await wire.until_running()
