"""A witness of the machine: the time for which it ran not even the most urgent process.

`python -m tests.scenes.system.witness` asks for real-time priority, says `ready`, sleeps in steps
of 1 ms. At the end of its standard input it prints how many seconds it overslept by more than 4 ms
each time: half cycles (8.3 ms) that a daemon of lower priority cannot have run either.
"""

import os
import select
import sys
import time

PRIORITY, STEP_S, LATE_S = 80, 0.001, 0.004


def main() -> None:
    """Watch until the input ends."""
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    lost_s, began_s = 0.0, time.monotonic()
    while not select.select([sys.stdin], [], [], STEP_S)[0]:
        now_s = time.monotonic()
        late_s, began_s = now_s - began_s - STEP_S, now_s
        lost_s += late_s if late_s > LATE_S else 0.0
    sys.stdout.write(f"{lost_s}\n")


if __name__ == "__main__":
    main()
