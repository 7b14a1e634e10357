"""Evidence that a decision about the load needs, in slow samples and in log odds.

Each slow period brings one innovation, and the slow period is chosen in proportion to the time
constants of the load, so that counts of samples suit a motor, a bath and a battery alike.
"""

FEWEST = 5
"""Samples that can show anything: as many as there are parameters, 4 to 6 for a bath or a motor."""

EARLIEST = 2 * FEWEST
"""Samples before a decision: twice as many as there are parameters."""

WINDOW = 2 * EARLIEST
"""Samples over which errors are a mean: twice those of the earliest decision."""

MEMORY = 60.0
"""Samples that an estimate remembers: 1/(1 - ρ) is 67 with the forgetting factor by default."""

LIFE = 3.0 * MEMORY
"""Samples after which a branch that has not become the estimate ends: it has forgotten the change
that split it off."""

CLEAR = 10.0
"""Lead that decides between two estimates: odds of e^10, 22,000 to 1."""

RARE = 5.0
"""Log odds against a disturbance at an alarm, 150 to 1: it may be noise. From such a lead on
another branch is the estimate."""

RARER = 9.0
"""Log odds against a load, and against a disturbance with it: 8,000 to 1."""

PRIOR_SHARE = 0.5
"""Relative deviation of gain and α before samples; nothing is known that is not below this."""

NOISE_FLOOR = 1.0e-8
"""Least variance: a ten-thousandth of the scale, squared, for rounding and model error."""

UNKNOWN = 2.0 * PRIOR_SHARE
"""Deviation of a scaled parameter that may be any: two more disks move α of a motor by 0.7."""

LOST_SHARE = 0.1
"""Share of the ticks of a slow period above which stand-ins make a sample that teaches nothing, and
k or V_c at a limit one whose V_c was not followed."""
