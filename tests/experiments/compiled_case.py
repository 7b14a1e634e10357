"""A case on compiled code, some thirty times as fast as `run_case`.

Compiling takes a minute or two for each kind of load and design: this is for many runs of one kind.
"""

from __future__ import annotations

from adaptdrive_sim.compiled import bench
from adaptdrive_sim.compiled.run import run_compiled
from adaptdrive_sim.experiments.case import Case
from adaptdrive_sim.experiments.runner import RunRecord, planned, start_case


def run_case_compiled(case: Case) -> RunRecord:
    """Run one case from start to end on compiled code.

    Returns:
        A record without reasons, gains, deviations and excitation.
    """
    course, controller, world = start_case(case)
    trace, cause = run_compiled(controller, world, course)
    if cause:
        raise RuntimeError(f"the run of seed {case.seed} ended by itself, cause {cause}")
    names = case.experiment.nominal().names
    return RunRecord(
        **planned(case.experiment, course),
        output=trace[:, bench.OUTPUT].tolist(),
        measured=trace[:, bench.MEASURED].tolist(),
        boost_reference_V=trace[:, bench.REFERENCE_V].tolist(),
        applied_V=trace[:, bench.APPLIED_V].tolist(),
        adaptive=(trace[:, bench.ADAPTIVE] > 0.0).tolist(),
        accepted=(trace[:, bench.ACCEPTED] > 0.0).tolist(),
        estimates={name: trace[:, bench.VALUES + i].tolist() for i, name in enumerate(names)},
        innovation=trace[:, bench.INNOVATION].tolist(),
    )
