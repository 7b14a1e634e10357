"""Settings of the controller, fixed when it is built."""

import math
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class PowerStage:
    """The drive, as far as the voltage loop depends on it.

    Attributes:
        capacitance_F: Boost capacitor.
        line_voltage_min_V: Lowest line voltage that the loop divides by.
        current_scale_min_S: Lower limit of k: 0, or negative for a bidirectional drive.
        current_scale_max_S: Upper limit of k.
        boost_reference_min_V: Lowest V_c.
        boost_reference_max_V: Highest V_c.
        load_power_max_W: Load power above which V_c is held back.
        holds_voltage: True for a drive with its own voltage loop.
        boost_needs_bridge: True for a drive whose boost stage works only with the bridge on.
        kick_ticks: Length of each part of a kick (`impulse_hold`); 0 to hold V_c.
        kick_first: Exaggeration of a change of V_c in the first part.
        kick_second: The same in the second part.
    """

    capacitance_F: float
    line_voltage_min_V: float
    current_scale_min_S: float
    current_scale_max_S: float
    boost_reference_min_V: float
    boost_reference_max_V: float
    load_power_max_W: float
    holds_voltage: bool
    boost_needs_bridge: bool = False
    kick_ticks: int = 0
    kick_first: float = 0.0
    kick_second: float = 0.0


@dataclass(frozen=True, slots=True)
class Rates:
    """The two rates and what links them.

    Attributes:
        ticks_per_period: Q.
        latency_ticks: L, fast ticks from a snapshot to the effect of its decision.
        samples: Fast samples averaged for a slow one.
        clip: Fast samples are clipped to this many mean deviations about their prediction; 0 not.
        nominal_tick_s: Half a line cycle at nominal frequency.
        lag_ticks: Mean delay from V_c to the boost voltage, of whichever loop holds it.
    """

    ticks_per_period: int
    latency_ticks: int
    samples: int
    nominal_tick_s: float
    lag_ticks: float
    clip: float = 0.0


@dataclass(frozen=True, slots=True)
class EstimatorSettings:
    """Settings of the estimation.

    Attributes:
        method: Name of the estimation method (`direct.METHODS`).
        forgetting: ρ.
        tau_lambda_s: τ_λ.
        initial_covariance: p0.
        settle_periods: Slow periods after start before the first update.
        gate: Update only on samples with rᵀPr above this multiple of 1 - ρ; 0 takes every sample.
        output_scale: Output of order one, for the conditioning of P.
        input_scale: Input of order one.
        start_at_nominal: Whether θ starts at the nominal model, else at 0.
        alert: Whether an abrupt change opens the estimator up.
        short_lag_s: Time constant of a lag that is too short to be learnt; 0 where there is none.
        bias: Whether a constant is estimated too: a load torque, an EMF, an offset of a sensor.
        initial_state: Whether what is left of the time before the start is estimated too.
        resolution: Smallest step of the measured output, 0 to find it in the samples.
        charge: Whether a disturbance in proportion to the integral of the output is estimated too:
            the EMF of a battery rises with its charge.
        drifts: Whether the bias moves by itself: the inflow of a bath changes its temperature.
    """

    method: str
    forgetting: float
    tau_lambda_s: float
    initial_covariance: float
    settle_periods: int = 0
    gate: float = 0.0
    output_scale: float = 1.0
    input_scale: float = 1.0
    start_at_nominal: bool = False
    alert: bool = False
    short_lag_s: float = 0.0
    bias: bool = False
    initial_state: bool = False
    resolution: float = 0.0
    charge: bool = False
    drifts: bool = False


@dataclass(frozen=True, slots=True)
class SupervisionLimits:
    """Limits for estimates and for the loop; one of 0, or left out, switches its check off.

    Attributes:
        warm_up_periods: Slow periods after start before adaptive may take over.
        ratio_min: Smallest accepted parameter, over its nominal value.
        ratio_max: Largest accepted parameter, over its nominal value.
        revokes: Whether a refused estimate ends the trust in the one before.
        damping_min: Smallest damping of a load of second order.
        spread_max: How far the response to a step may be off within the covariance of the
            estimate, as a share of the step.
        residual_margin: Largest innovation, over that of the nominal model.
        dwell_periods: Good estimates in a row before the first of them goes live.
        blend_periods: Slow periods over which one law hands over to the other.
        saturated_periods: Longest time with the input at a limit and the output on no way to rest.
        error_limit: Error that must not last with a free input, in the unit of the output.
        swing_min: Smallest peak that counts as a swing, in the unit of the output; infinite to look
            for no swings and no limit cycles.
        response_periods: Longest wait at a limit for the output to move where a model does.
        response_distance: Movement that counts, in the unit of the output.
        noise_max: Largest standard deviation of the input that noise of the output may cause, in
            the unit of the input.
        confidence: Standard deviations by which the estimate may be wrong without new gains
            becoming unstable.
    """

    warm_up_periods: int
    ratio_min: float = -math.inf
    ratio_max: float = math.inf
    revokes: bool = False
    damping_min: float = 0.0
    spread_max: float = 0.0
    residual_margin: float = 0.0
    dwell_periods: int = 1
    blend_periods: int = 1
    saturated_periods: int = 0
    error_limit: float = 0.0
    swing_min: float = math.inf
    response_periods: int = 0
    response_distance: float = 0.0
    confidence: float = 0.0
    noise_max: float = 0.0


@dataclass(frozen=True, slots=True)
class Probing:
    """Limits of the probing.

    Attributes:
        amplitude: Largest distance from the set-point, in the unit of the output, or as a share of
            a charging current; 0 for no probing.
        stale_periods: Slow periods after which information is old, and least pause between probes.
        settle_periods: Slow periods after the start in which nothing is learnt.
        lowest: Lowest set-point.
        highest: Highest set-point.
    """

    amplitude: float = 0.0
    stale_periods: int = 0
    settle_periods: int = 0
    lowest: float = -math.inf
    highest: float = math.inf


@dataclass(frozen=True, slots=True)
class ControllerSettings:
    """Everything but the load itself.

    Attributes:
        exact: True for the held model with delays and filter, False for the paper's design.
        stage: The power stage.
        rates: The two rates.
        learning: The estimator.
        supervision: The supervisor.
        probing: The probing, off by default.
    """

    exact: bool
    stage: PowerStage
    rates: Rates
    learning: EstimatorSettings
    supervision: SupervisionLimits
    probing: Probing = field(default_factory=Probing)
