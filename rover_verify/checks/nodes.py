"""Real-time factor of the simulator as a process."""

from __future__ import annotations

import statistics

from msg_schemas import topics
from rover_sim import compile_ahead, load_scenario
from rover_verify.checks import CheckBatch, Measured
from rover_verify.harness import open_harness

SIM = "rover_sim.node.sim_node"
_SCENARIO = "paper_table1_high"


def real_time_factor(batch: CheckBatch) -> Measured:
    """Largest relative deviation of the measured real-time factor from the requested one."""
    # Compiled here first, so that the node finds it in the cache.
    compile_ahead(load_scenario(_SCENARIO))
    medians = {}
    with open_harness(batch.folder) as harness:
        harness.processes.start(SIM, {"scenario": _SCENARIO})
        observer = harness.observer()
        feed = observer.listen(topics.SIM_STATUS)
        for factor in (0.5, 1.0, 2.0):
            observer.set_parameter("sim_node", "real_time_factor", factor)
            readings = [
                float(sample.statuses[0].values["measured_real_time_factor"] or "nan")
                for sample in feed.wait_for_count(len(feed) + 40)[-10:]
            ]
            medians[factor] = statistics.median(readings)
    details = {f"factor {factor:g}": median for factor, median in medians.items()}
    worst = max(abs(median / factor - 1.0) for factor, median in medians.items())
    return Measured(worst, "median of 10 readings, 3 s after each change", details)
