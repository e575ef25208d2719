"""How many frames the machine alone makes late: `python -m tissue_sim.machine_lateness 300`.

A loop that shares nothing with anybody, at the simulation's rate and priority, that computes for as
long as a frame of the heart takes. What is late here, no simulation on this machine can avoid.
"""

from __future__ import annotations

import sys
import threading
import time

from tissue_sim.realtime import FixedRate, take_priority

RATE_HZ = 60.0
PRIORITY = 50
WORK_SECONDS = 0.005


def late_share(frames: int) -> float:
    """Share of late frames; the calling thread keeps the priority."""
    take_priority(PRIORITY)
    rate, never = FixedRate(RATE_HZ), threading.Event()
    rate.start()
    for _ in range(frames):
        rate.wait(never)
        begun = time.thread_time()
        while time.thread_time() - begun < WORK_SECONDS:
            pass
        rate.published()
    return rate.late / rate.count


if __name__ == "__main__":
    print(late_share(int(sys.argv[1])))
