"""`[interlocks]`, `[mqtt]`, `[recording]`, `[realtime]`: what surrounds the controller."""

from __future__ import annotations

import ipaddress
import re
from typing import Annotated, Self

from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from adaptdrive.config.section import (
    FilePath,
    FiniteFloat,
    NonNegativeFloat,
    PositiveFloat,
    Section,
    key,
)

LONGEST_STALE_S = 2.0
"""A drive that is read each half cycle is then commanded 240 times on held values; one that is
polled once a second may lose one poll."""

_LABEL = re.compile(r"(?!-)[A-Za-z0-9_-]{1,63}(?<!-)")
_LONGEST_NAME = 253  # RFC 1035


def check_host(host: str) -> str:
    """Return a host that can be looked up.

    Args:
        host: Name or address.

    Raises:
        ValueError: It is neither an IP address nor a host name.
    """
    try:
        ipaddress.ip_address(host)
    except ValueError:
        _check_name(host)
    return host


def _check_name(host: str) -> None:
    try:
        name = host.encode("idna").decode("ascii").removesuffix(".")
    except UnicodeError as problem:
        raise ValueError(f"{host!r} is no host name: {problem}") from problem
    labels = name.split(".")
    if len(name) > _LONGEST_NAME or not all(_LABEL.fullmatch(label) for label in labels):
        raise ValueError(
            f"{host!r} is neither an IP address nor a host name: labels of 1 to 63 letters, digits "
            "and '-', separated by dots"
        )


class InterlocksSection(Section):
    """`[interlocks]`: limits that trip the drive; a trip is latched until `reset`."""

    stale_s: PositiveFloat = key(
        0.05,
        "greatest age of a measurement; until then ticks use held values, then trip",
        le=LONGEST_STALE_S,
    )
    boost_voltage_max_V: PositiveFloat = key(430.0, "over-voltage trip")
    output_max: FiniteFloat = Field(description="trip when the output is above")
    output_min: FiniteFloat | None = key(
        None,
        "trip when the output is below (a reversed sensor); a quarter of the "
        "set-point range below 0 and `load.reference_min` when left out",
    )
    stuck_distance: float = key(
        0.05,
        "trip when the output stands at exactly one value although the model moves by this share "
        "of the set-point range and twenty steps of `load.resolution`; 0: never; not for a battery",
        span=(0.0, 1.0),
    )
    stuck_s: NonNegativeFloat = key(
        0.0,
        "trip when the output has exactly one value for this time while running, "
        "for sensors with noise above their last digit; 0: never",
        le=3600.0,
    )
    response_factor: float = key(
        4.0,
        "trip when the output is lower than a load with so many times less gain "
        "than `load.model` gives, or falls faster than a load can; 0: never",
        span=(0.0, 100.0),
    )
    precharge_timeout_s: PositiveFloat = key(
        5.0,
        "longest precharge in `starting`, and longest wait for the rate of the half cycles before",
        le=600.0,
    )
    start_s: PositiveFloat | None = key(
        None,
        "trip when the drive has not reported its bridge on within this time after "
        "the command; at least three readings; 30 half cycles when left out",
        le=5.0,
    )
    stop_s: float = key(
        0.5,
        "trip when the drive has not reported its bridge off within this time after a "
        "stop; at least four readings",
        gt=0.0,
        le=5.0,
    )
    refused_share: float = key(
        0.0,
        "trip when this share of the frames of the drive or of a sensor bus was "
        "refused over 5 s; 0: never; an event reports a tenth and more",
        span=(0.0, 1.0),
    )

    @field_validator("response_factor")
    @classmethod
    def _is_a_factor(cls, factor: float) -> float:
        if 0.0 < factor < 1.0:
            raise ValueError(f"{factor:g} must be 0, or at least 1")
        return factor


class Mqtt(Section):
    """`[mqtt]`: the broker that carries state, telemetry and commands."""

    host: Annotated[str, AfterValidator(check_host)] = key("127.0.0.1", "broker")
    port: int = key(1883, "port of the broker", span=(1, 65535))
    tls: bool = key(False, "connect to the broker with TLS")
    ca_file: FilePath | None = key(None, "certificate authority for TLS")
    username: str | None = key(None, "user name")
    password_file: FilePath | None = key(None, "file that holds the password")
    telemetry_Hz: float = key(
        10.0,
        "rate of `telemetry/drive`; at least 1 where a daemon runs, as a drive that "
        "is silent for 3 s counts as gone",
        span=(0.01, 10.0),
    )
    home_assistant: str | None = key(
        None,
        "prefix of Home Assistant's discovery, usually `homeassistant`; not "
        "announced when left out",
        pattern="^[A-Za-z0-9_/-]+$",
    )

    @model_validator(mode="after")
    def _authority_needs_tls(self) -> Self:
        if self.ca_file is not None and not self.tls:
            raise ValueError(
                f"ca_file = {str(self.ca_file)!r} without tls: user name and password would go "
                "over the wire in clear; set tls = true, or leave ca_file out"
            )
        return self


class Recording(Section):
    """`[recording]`: what is kept of a session."""

    enabled: bool = key(True, "record sessions")
    directory: FilePath | None = key(
        None, "folder of the sessions; $STATE_DIRECTORY/sessions or ./sessions when left out"
    )
    flush_s: float = key(0.2, "longest time before data are written", span=(0.1, 60.0))
    segment_s: float = key(
        3600.0, "time after which a session continues in new files", span=(1.0, 86_400.0)
    )
    keep_days: PositiveFloat | None = key(
        None, "remove sessions that began longer ago; none when left out"
    )
    keep_MB: PositiveFloat | None = key(
        None, "remove the oldest while all sessions take more; none when left out"
    )


class Realtime(Section):
    """`[realtime]`: how hard the fast loop is protected from the rest of the machine."""

    timer_standin: bool = key(True, "run a stand-in tick when the drive's frame is late")
    late_fraction: float = key(
        0.5,
        "how late a frame may be, as a fraction of a tick, before a stand-in tick runs",
        gt=0.0,
        lt=1.0,
    )
    priority: int | None = key(
        None, "SCHED_FIFO priority; ordinary scheduling without", span=(1, 98)
    )
    cpus: list[int] = key([], "CPUs that the daemon may run on; all when empty")
    cpu_latency_us: int | None = key(
        None,
        "longest time that idle CPUs may take to wake up; shorter needs more power",
        span=(0, 10_000),
    )
    lock_memory: bool = key(False, "keep the daemon's memory in RAM")
    freeze_gc: bool = key(True, "collect garbage in idle time after a tick, young objects only")
    warm_up: bool = key(True, "rehearse ticks and slow steps before the bus is opened")
    rehearse_us: float = key(
        0.0,
        "rehearse a tick at this time before the next frame, to warm the CPU's "
        "caches; takes the CPU time of a tick; 0: never",
        span=(0.0, 3000.0),
    )
    spin_us: float = key(
        0.0,
        "busy wait before the next frame or deadline; costs that share of a CPU",
        span=(0.0, 1000.0),
    )
    late_us: PositiveFloat = key(
        2000.0,
        "lateness from which a tick is reported as an event, with its cause",
        span=(10.0, 1e6),
    )

    @field_validator("spin_us")
    @classmethod
    def _comes_after_the_rehearsal(cls, spin_us: float, info: ValidationInfo) -> float:
        rehearse_us = info.data.get("rehearse_us", 0.0)
        if spin_us >= rehearse_us > 0.0:
            raise ValueError(
                f"{spin_us:g} leaves no time for the rehearsal before it: rehearse_us = "
                f"{rehearse_us:g} must be larger"
            )
        return spin_us

    @field_validator("cpus")
    @classmethod
    def _are_cpus(cls, cpus: list[int]) -> list[int]:
        if any(cpu < 0 for cpu in cpus):
            raise ValueError(f"{cpus}: CPUs are counted from 0")
        return cpus
