"""Modules whose rules keep a drive safe, and the tests that must hold each of them."""

from __future__ import annotations

_LOOP = ("tests/unit/runtime/test_fast_loop.py", "tests/unit/runtime/test_fast_loop_decisions.py")
_LOOP_MORE = ("tests/unit/runtime/test_deadlines.py", "tests/unit/runtime/test_polled_drive.py")
_MACHINE = (
    "tests/unit/runtime/test_machine.py",
    "tests/unit/runtime/test_machine_manual.py",
    "tests/unit/runtime/test_machine_properties.py",
)
_STOP = ("tests/unit/runtime/test_stop_watch.py",)
_RATE = (
    "tests/unit/runtime/test_half_cycles.py",
    "tests/unit/safety/test_frame_rate.py",
    "tests/unit/runtime/test_polled_drive.py",
)

RUNTIME: dict[str, tuple[str, ...]] = {
    "adaptdrive.safety.interlocks": (
        "tests/unit/safety/test_interlocks.py",
        "tests/unit/safety/test_interlock_board.py",
        *_LOOP,
        "tests/unit/safety/test_monitor.py",
    ),
    "adaptdrive.safety.guard": ("tests/unit/safety/test_guard.py", *_LOOP),
    "adaptdrive.safety.monitor": (
        "tests/unit/safety/test_monitor.py",
        "tests/unit/devices/test_can_port.py",
        *_LOOP,
    ),
    "adaptdrive.safety.stop": (*_STOP, *_LOOP),
    "adaptdrive.runtime.state_machine": (
        *_MACHINE,
        "tests/unit/runtime/test_fast_loop_decisions.py",
    ),
    "adaptdrive.runtime.settings": (
        "tests/unit/runtime/test_machine_manual.py",
        *_MACHINE,
    ),
    "adaptdrive.runtime.fast_loop": (
        *_LOOP,
        *_LOOP_MORE,
        *_STOP,
        "tests/unit/runtime/test_statistics.py",
    ),
    "adaptdrive.runtime.timebase": (
        "tests/unit/safety/test_counter_watch.py",
        *_RATE,
        "tests/unit/runtime/test_fast_loop.py",
    ),
    "adaptdrive.safety.frames": (*_RATE, "tests/unit/safety/test_counter_watch.py"),
    "adaptdrive.runtime.stopping": (
        *_STOP,
        "tests/unit/safety/test_monitor.py",
        *_LOOP,
        "tests/unit/safety/test_frame_rate.py",
    ),
    "adaptdrive.control.schedule": (
        "tests/unit/control/test_schedule.py",
        *_LOOP,
    ),  # the loop's order
}

_CAN_PORT = ("tests/contracts/port/test_port.py", "tests/unit/devices/test_can_port.py")
_CANOPEN_PORT = ("tests/contracts/port/test_port.py", "tests/unit/devices/canopen/test_port.py")
_MODBUS = (
    "tests/contracts/port/test_port.py",
    "tests/unit/devices/modbus/test_port.py",
    "tests/unit/devices/modbus/test_faults.py",
    "tests/unit/devices/modbus/test_writing.py",
)
_LOST = ("tests/unit/devices/modbus/test_losses.py",)
_FRAMES = ("tests/unit/devices/test_can_codec.py", "tests/unit/devices/test_can_crc.py")

DEVICES: dict[str, tuple[str, ...]] = {
    "adaptdrive.devices.can.port": _CAN_PORT,
    "adaptdrive.devices.can.mapping": (
        "tests/unit/devices/test_can_mapping.py",
        "tests/unit/devices/test_can_description.py",
        "tests/unit/devices/test_can_pages.py",
        *_CAN_PORT,
    ),
    "adaptdrive.devices.can.codec": _FRAMES,
    "adaptdrive.devices.can.integrity": (
        "tests/unit/devices/test_can_integrity.py",
        *_FRAMES,
        "tests/unit/devices/test_arrival.py",
    ),
    "adaptdrive.devices.canopen.port": (
        *_CANOPEN_PORT,
        "tests/unit/devices/canopen/test_frames.py",
        "tests/unit/devices/canopen/test_unseen.py",
    ),
    "adaptdrive.devices.modbus": (*_MODBUS, "tests/unit/devices/modbus/test_sensors.py"),
    "adaptdrive.devices.modbus.frames": (*_MODBUS, "tests/unit/devices/modbus/test_functions.py"),
    "adaptdrive.devices.polled.commander": (
        "tests/unit/devices/test_commander.py",
        *_MODBUS,
        *_LOST,
    ),
    "adaptdrive.devices.polled.reports": (*_MODBUS, *_LOST),
    "adaptdrive.devices.polled.link": (*_MODBUS, "tests/unit/devices/modbus/test_names.py"),
    "adaptdrive.devices.scpi": (
        "tests/unit/devices/scpi/test_port.py",
        "tests/contracts/port/test_port.py",
    ),
    "adaptdrive.safety.facts": (
        "tests/unit/devices/test_fault_words.py",
        *_CAN_PORT,
        "tests/unit/devices/canopen/test_port.py",
    ),
}

MQTT: dict[str, tuple[str, ...]] = {
    "adaptdrive.mqtt.desk": ("tests/unit/mqtt/test_desk.py",),
    "adaptdrive.mqtt.publisher": (
        "tests/unit/mqtt/test_intake.py",
        "tests/unit/mqtt/test_history.py",
        "tests/unit/mqtt/test_service.py",
        "tests/unit/mqtt/test_link.py",
    ),
    "adaptdrive.mqtt.commands": (
        "tests/unit/mqtt/test_commands.py",
        "tests/unit/mqtt/test_desk.py",
        "tests/unit/mqtt/test_service.py",
    ),
    "adaptdrive.mqtt.client": (
        "tests/unit/mqtt/test_sender.py",
        "tests/unit/mqtt/test_asyncio_program.py",
    ),
}

RECORDING: dict[str, tuple[str, ...]] = {
    "adaptdrive.recording.log": (
        "tests/unit/recording/test_log.py",
        "tests/unit/recording/test_recorder.py",
        "tests/unit/mqtt/test_stores.py",
    ),
    "adaptdrive.recording.recorder": ("tests/unit/recording/test_recorder.py",),
    "adaptdrive.recording.archive": (
        "tests/unit/recording/test_archive.py",
        "tests/unit/recording/test_recorder.py",
    ),
    "adaptdrive.recording.session": (
        "tests/unit/recording/test_session.py",
        "tests/unit/recording/test_round_trip.py",
        "tests/unit/recording/test_retention.py",
        "tests/unit/recording/test_archive.py",
    ),
}


def _control(tests: dict[str, str]) -> dict[str, tuple[str, ...]]:
    """Return modules of the controller with the files of their tests."""
    return {
        f"adaptdrive.control.{module}": tuple(
            f"tests/unit/control/{name}.py" for name in names.split()
        )
        for module, names in tests.items()
    }


SUPERVISION = _control({
    "supervision.monitor": "test_watch",
    "estimation.change": "test_bank test_doubt test_methods",
    "estimation.filters": "test_screen test_lambda_filter test_rounding",
    "supervision.setpoints": "test_probing test_rest",
    "loads.battery": "test_charging test_slow_half test_loads test_certainty",
    "supervision.supervisor": "test_supervisor",
    "design.pole_placement": "test_certainty test_pole_placement test_design",
    "design.noise": "test_fast_feedback",
    "design.reference": "test_fast_feedback",
    "supervision.state": "test_reasons test_slow_half test_probing",
    "supervision.redesign": "test_redesign",
})  # fmt: skip

LEARNING = _control({
    "estimation.regression": "test_lambda_filter test_estimator test_bank test_methods",
    "estimation.rls": "test_rls test_beside",
    "estimation.bank": "test_bank test_doubt test_drift",
    "estimation.estimator": (
        "test_estimator test_runs test_redesign "
        "test_bank test_methods test_certainty"
    ),
    "estimation.direct": "test_methods test_discretise",
})  # fmt: skip

DESIGN = _control({
    "vectors": "test_vectors",
    "loads.discretise": "test_discretise test_impulse_hold",
    "signals": "test_waveform",
    "loads.load": "test_loads",
    "loads.motor": "test_loads test_certainty",
    "loads.bath": "test_loads test_certainty",
})  # fmt: skip

HALVES = _control({
    "fast": "test_fast_half test_rounding test_voltage_loop",
    "slow": (
        "test_slow_half test_charging test_certainty "
        "test_probing test_runs test_pole_placement"
    ),
    "controller": "test_controller test_schedule test_runs",
})  # fmt: skip

PARTS = {
    "devices": DEVICES,
    "recording": RECORDING,
    "supervision": SUPERVISION,
    "learning": LEARNING,
    "design": DESIGN,
    "halves": HALVES,
}
"""Parts of the product, of each of whose modules a sample of mutants is tried."""

CONTROL = SUPERVISION | LEARNING | DESIGN | HALVES

TARGETS = RUNTIME | DEVICES | MQTT | RECORDING | CONTROL
