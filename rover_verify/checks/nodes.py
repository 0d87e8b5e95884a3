"""Nodes as separate processes over DDS: rates, real time, and exit."""

from __future__ import annotations

import signal
import statistics
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from msg_schemas import topics
from msg_schemas.access import ACCESS
from msg_schemas.events import NodeEvent
from msg_schemas.table import JUMP_SCREW, TOPICS
from rover_sim import compile_ahead, load_scenario
from rover_verify.checks import CheckBatch, Measured
from rover_verify.harness import NodeHarness, Observer, Process, open_harness

SIM, JUMP, WINCH, RECORD = (
    "rover_sim.node.sim_node",
    "rover_control.jump.jump_node",
    "tether_winch.winch_node",
    "rover_bags.recording.record",
)
SCENARIO = "paper_table1_high"
_WITH_ALL_TOPICS = "free_hang"
_NANO = 1_000_000_000
_PERIOD_NS = 50_000_000


@contextmanager
def simulation(
    batch: CheckBatch, scenario: str = SCENARIO, **parameters: object
) -> Iterator[tuple[NodeHarness, Process, Observer]]:
    """A running sim_node, and an observer that receives its clock."""
    # Compiled here first, so that the node finds it in the cache.
    compile_ahead(load_scenario(scenario))
    with open_harness(batch.folder) as harness:
        process = harness.processes.start(SIM, {"scenario": scenario, **parameters})
        observer = harness.observer()
        for name in (topics.EVENTS, topics.DIAGNOSTICS, topics.CLOCK):
            observer.listen(name)
        observer.listen(topics.CLOCK).wait(lambda sample: sample.stamp_ns >= 0)
        yield harness, process, observer


def drive_nut(
    observer: Observer, compression: float, speed: float, until: Callable[[], object]
) -> None:
    """Stream nut commands at 20 Hz of simulated time until a condition holds."""
    while not until():
        observer.send_joint(topics.JUMP_MOTOR_COMMAND, JUMP_SCREW, compression, speed, 400.0)
        observer.wait_for_time(observer.time_ns() + _PERIOD_NS)


def wait_until_active(observer: Observer, node: str, since: int = 0) -> None:
    """Wait until a node reports that it is active."""
    observer.wait_for_status(
        topics.EVENTS, lambda s: s.name == NodeEvent.ACTIVE and s.hardware_id == node, since
    )


def real_time_factor(batch: CheckBatch) -> Measured:
    """Largest relative deviation of the measured real-time factor from the requested one."""
    details, worst = {}, 0.0
    with simulation(batch) as (_, _, observer):
        feed = observer.listen(topics.SIM_STATUS)
        for factor in (0.5, 1.0, 2.0):
            observer.set_parameter("sim_node", "real_time_factor", factor)
            readings = [
                float(sample.statuses[0].values["measured_real_time_factor"] or "nan")
                for sample in feed.wait_for_count(len(feed) + 40)[-10:]
            ]
            details[f"factor {factor:g}"] = statistics.median(readings)
            off = abs(statistics.median(readings) / factor - 1.0)
            worst = max(worst, off)
    return Measured(worst, "median of 10 readings, 3 s after each change", details)


def ends_cleanly(batch: CheckBatch) -> Measured:
    """Number of exits on SIGINT and SIGTERM with a code other than 0 or a remaining process."""
    modules = (SIM, JUMP, WINCH, RECORD)
    bad, total, details = 0, 0, {}
    compile_ahead(load_scenario(SCENARIO))
    for number, twice in ((signal.SIGINT, False), (signal.SIGINT, True), (signal.SIGTERM, False)):
        name = f"{number.name}{' twice' if twice else ''}"
        with open_harness(batch.folder) as harness:
            processes = {}
            for module in modules:
                arguments = ("-o", f"bag_{name.replace(' ', '_')}") if module == RECORD else ()
                processes[module] = harness.processes.start(module, None, *arguments)
            observer = harness.observer()
            for module in modules:
                node = module.rpartition(".")[2].replace("record", "bag_record")
                wait_until_active(observer, node)
            for module, process in processes.items():
                total += 1
                process.send_to_group(number)
                if twice:
                    process.send_to_group(number)
                code = process.wait()
                if code != 0 or not process.has_group_exited():
                    bad += 1
                    details[f"{module}, {name}"] = f"code {code}"
    return Measured(bad, f"of {total} exits: four nodes, SIGINT, SIGINT twice, SIGTERM", details)


def state_rates(batch: CheckBatch) -> Measured:
    """Largest relative deviation of a topic's period in simulated time from the contract."""
    with simulation(batch, _WITH_ALL_TOPICS, real_time_factor=1.0) as (_, _, observer):
        rows = [
            row
            for row in TOPICS.values()
            if row.name in ACCESS["sim_node"].publishes
            and row.rate
            and row.name not in (topics.SIM_STATUS, topics.TRUTH_STATE)  # without a stamp
        ]
        feeds = {row.name: observer.listen(row.name) for row in rows}
        details = {}
        for row in rows:
            stamps = [sample.stamp_ns for sample in feeds[row.name].wait_for_count(42)][1:]
            period = (stamps[-1] - stamps[0]) / (len(stamps) - 1) * 1e-9
            assert row.rate is not None
            details[row.name] = abs(period * row.rate - 1.0)
    return Measured(max(details.values()), f"{len(details)} topics", details)
