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

    stale_s: PositiveFloat = Field(
        default=0.05,
        le=LONGEST_STALE_S,
        description="greatest age of a measurement; until then ticks use held values, then trip",
    )
    boost_voltage_max_V: PositiveFloat = Field(default=430.0, description="over-voltage trip")
    output_max: FiniteFloat = Field(description="trip when the output is above")
    output_min: FiniteFloat | None = Field(
        default=None,
        description="trip when the output is below (a reversed sensor); a quarter of the "
        "set-point range below 0 and `load.reference_min` when left out",
    )
    stuck_distance: float = Field(
        default=0.05,
        ge=0.0,
        le=1.0,
        description="trip when the output stands at exactly one value although the model moves "
        "by this share of the set-point range and twenty steps of `load.resolution`; 0: never; "
        "not for a battery",
    )
    stuck_s: NonNegativeFloat = Field(
        default=0.0,
        le=3600.0,
        description="trip when the output has exactly one value for this time while running, "
        "for sensors with noise above their last digit; 0: never",
    )
    response_factor: float = Field(
        default=4.0,
        ge=0.0,
        le=100.0,
        description="trip when the output is lower than a load with so many times less gain "
        "than `load.model` gives, or falls faster than a load can; 0: never",
    )
    precharge_timeout_s: PositiveFloat = Field(
        default=5.0,
        le=600.0,
        description="longest precharge in `starting`, and longest wait for the rate of the half "
        "cycles before",
    )
    start_s: PositiveFloat | None = Field(
        default=None,
        le=5.0,
        description="trip when the drive has not reported its bridge on within this time after "
        "the command; at least three readings; 30 half cycles when left out",
    )
    stop_s: float = Field(
        default=0.5,
        gt=0.0,
        le=5.0,
        description="trip when the drive has not reported its bridge off within this time after a "
        "stop; at least four readings",
    )
    refused_share: float = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="trip when this share of the frames of the drive or of a sensor bus was "
        "refused over 5 s; 0: never; an event reports a tenth and more",
    )

    @field_validator("response_factor")
    @classmethod
    def _is_a_factor(cls, factor: float) -> float:
        if 0.0 < factor < 1.0:
            raise ValueError(f"{factor:g} must be 0, or at least 1")
        return factor


class Mqtt(Section):
    """`[mqtt]`: the broker that carries state, telemetry and commands."""

    host: Annotated[str, AfterValidator(check_host)] = Field(
        default="127.0.0.1", description="broker"
    )
    port: int = Field(default=1883, ge=1, le=65535, description="port of the broker")
    tls: bool = Field(default=False, description="connect to the broker with TLS")
    ca_file: FilePath | None = Field(default=None, description="certificate authority for TLS")
    username: str | None = Field(default=None, description="user name")
    password_file: FilePath | None = Field(default=None, description="file that holds the password")
    telemetry_Hz: float = Field(
        default=10.0,
        ge=0.01,
        le=10.0,
        description="rate of `telemetry/drive`; at least 1 where a daemon runs, as a drive that "
        "is silent for 3 s counts as gone",
    )
    home_assistant: str | None = Field(
        default=None,
        pattern="^[A-Za-z0-9_/-]+$",
        description="prefix of Home Assistant's discovery, usually `homeassistant`; not "
        "announced when left out",
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

    enabled: bool = Field(default=True, description="record sessions")
    directory: FilePath | None = Field(
        default=None,
        description="folder of the sessions; $STATE_DIRECTORY/sessions or ./sessions when left out",
    )
    flush_s: float = Field(
        default=0.2, ge=0.1, le=60.0, description="longest time before data are written"
    )
    segment_s: float = Field(
        default=3600.0,
        ge=1.0,
        le=86_400.0,
        description="time after which a session continues in new files",
    )
    keep_days: PositiveFloat | None = Field(
        default=None, description="remove sessions that began longer ago; none when left out"
    )
    keep_MB: PositiveFloat | None = Field(
        default=None,
        description="remove the oldest while all sessions take more; none when left out",
    )


class Realtime(Section):
    """`[realtime]`: how hard the fast loop is protected from the rest of the machine."""

    timer_standin: bool = Field(
        default=True, description="run a stand-in tick when the drive's frame is late"
    )
    late_fraction: float = Field(
        default=0.5,
        gt=0.0,
        lt=1.0,
        description="how late a frame may be, as a fraction of a tick, before a stand-in tick runs",
    )
    priority: int | None = Field(
        default=None, ge=1, le=98, description="SCHED_FIFO priority; ordinary scheduling without"
    )
    cpus: list[int] = Field(
        default=[], description="CPUs that the daemon may run on; all when empty"
    )
    cpu_latency_us: int | None = Field(
        default=None,
        ge=0,
        le=10_000,
        description="longest time that idle CPUs may take to wake up; shorter needs more power",
    )
    lock_memory: bool = Field(default=False, description="keep the daemon's memory in RAM")
    freeze_gc: bool = Field(
        default=True, description="collect garbage in idle time after a tick, young objects only"
    )
    warm_up: bool = Field(
        default=True, description="rehearse ticks and slow steps before the bus is opened"
    )
    rehearse_us: float = Field(
        default=0.0,
        ge=0.0,
        le=3000.0,
        description="rehearse a tick at this time before the next frame, to warm the CPU's "
        "caches; takes the CPU time of a tick; 0: never",
    )
    spin_us: float = Field(
        default=0.0,
        ge=0.0,
        le=1000.0,
        description="busy wait before the next frame or deadline; costs that share of a CPU",
    )
    late_us: PositiveFloat = Field(
        default=2000.0,
        ge=10.0,
        le=1e6,
        description="lateness from which a tick is reported as an event, with its cause",
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
