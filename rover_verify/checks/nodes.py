"""Nodes as separate processes over DDS: invalid commands, services, real time, and exit."""

from __future__ import annotations

import json
import math
import signal
import statistics
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from msg_schemas import topics
from msg_schemas.access import ACCESS
from msg_schemas.events import NodeEvent, PlantEvent, SimulationEvent
from msg_schemas.phases import PlantPhase
from msg_schemas.samples import JointSample, JointValue, Status
from msg_schemas.table import JUMP_SCREW, JUMP_STROKE, TOPICS
from rover_sim import PlanarPlant, compile_ahead, jump, load_scenario
from rover_verify.checks import Batch, Measured
from rover_verify.harness import NodeHarness, Observer, Process, open_harness
from rover_verify.harness.joint_message import JointMessage

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
_DIVERGING = '{"integration.tolerance": 1.0e-300, "integration.max_halvings": 0}'


@contextmanager
def simulation(
    batch: Batch, scenario: str = SCENARIO, **parameters: object
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
    observer: Observer, compression: float, speed: float, until: Callable[[], bool]
) -> None:
    """Stream nut commands at 20 Hz of simulated time until a condition holds."""
    while not until():
        observer.send_joint(topics.JUMP_MOTOR_COMMAND, JUMP_SCREW, compression, speed, 400.0)
        wait_until_time(observer, observer.time_ns() + _PERIOD_NS)


def wait_until_time(observer: Observer, stamp_ns: int) -> None:
    """Wait for a simulated time."""
    clock = observer.listen(topics.CLOCK)
    clock.wait(lambda sample: sample.stamp_ns >= stamp_ns, max(0, len(clock) - 1))


def wait_until_active(observer: Observer, node: str, since: int = 0) -> None:
    """Wait until a node reports that it is active."""
    observer.wait_for_status(
        topics.EVENTS, lambda s: s.name == NodeEvent.ACTIVE and s.hardware_id == node, since
    )


def has_event(observer: Observer, name: str) -> Callable[[], bool]:
    """Returns a function that reports whether an event has occurred."""
    feed = observer.listen(topics.EVENTS)
    return lambda: any(s.name == name for sample in feed.samples for s in sample.statuses)


def _invalid(change: Callable[[JointMessage], None]) -> Callable[[int], bytes]:
    def make(stamp_ns: int) -> bytes:
        sample = JointSample(stamp_ns, {JUMP_SCREW: JointValue(0.1, 0.1, 400.0)})
        message = JointMessage.of(sample)
        change(message)
        return message.serialized()

    return make


def _set(part: str, value: float) -> Callable[[int], bytes]:
    return _invalid(lambda message: getattr(message, part).__setitem__(0, value))


def _aged(seconds: float) -> Callable[[int], bytes]:
    def age(message: JointMessage) -> None:
        message.stamp_ns = max(message.stamp_ns - round(seconds * 1e9), 1)

    return _invalid(age)


def _unstamp(message: JointMessage) -> None:
    message.stamp_ns = 0


_INVALID = {
    "not_finite": (_set("position", math.nan), _set("velocity", math.inf)),
    "out_of_limits": (_set("position", 5.0), _set("velocity", 0.0), _set("effort", -1.0)),
    "wrong_name": (_invalid(lambda message: setattr(message, "name", ["winch_drum"])),),
    "wrong_length": (_invalid(lambda message: message.position.append(0.0)),),
    "unstamped": (_invalid(_unstamp),),
    "stale": (_aged(0.8),),
    "from_the_future": (_aged(-5.0),),
}


def bad_commands(batch: Batch) -> Measured:
    """Number of invalid commands over DDS that are not refused with a reason, or have an effect."""
    missed, total, details = 0, 0, {}
    with simulation(batch, real_time_factor=2.0) as (_, process, observer):
        nut = observer.listen(topics.JUMP_MOTOR_STATE)
        observer.listen(topics.CLOCK).wait(lambda sample: sample.stamp_ns > 3 * _NANO)
        publisher = observer.publisher(topics.JUMP_MOTOR_COMMAND)
        for code, makers in _INVALID.items():
            for make in makers:
                total += 1
                since = len(observer.listen(topics.DIAGNOSTICS))
                publisher.publish(make(observer.time_ns()))
                try:
                    status = observer.wait_for_refusal(topics.JUMP_MOTOR_COMMAND, code, since)
                    details[f"{total}: {code}"] = status.message
                except AssertionError as error:
                    missed += 1
                    details[f"{total}: {code}"] = f"NOT REFUSED: {str(error)[:100]}"
        moved = max(abs(sample.joints[JUMP_SCREW].position) for sample in nut.samples)
        if moved > 0.0:
            missed += 1
            details["nut"] = f"moved {moved} m"
        # A valid command is executed afterwards.
        drive_nut(observer, 0.1, 0.4, has_event(observer, PlantEvent.TAKE_OFF))
        if process.stop() != 0:
            missed += 1
            details["exit"] = "not 0"
    return Measured(missed, f"of {total} invalid commands; then a valid one executed", details)


def jump_difference(batch: Batch) -> Measured:
    """Difference in height [m] of a jump commanded over DDS from the same jump in Python."""
    overrides = {"start.geometry": "+K", "start.slack": 2.0}
    changed = json.dumps(overrides)
    with simulation(batch, overrides=changed, real_time_factor=2.0) as (_, _, observer):
        drive_nut(observer, 0.2, 0.4, has_event(observer, PlantEvent.TAKE_OFF))
        values = observer.wait_for_event(PlantEvent.TOUCHDOWN).values
    own = jump(PlanarPlant(load_scenario(SCENARIO, overrides)))
    details = {
        "height [m]": float(values["height"]),
        "height in Python [m]": own.height,
        "attitude variation [rad]": float(values["attitude_variation"]),
        "attitude variation in Python [rad]": own.attitude_variation,
    }
    return Measured(abs(float(values["height"]) - own.height), "n = 5, +K, s = 2", details)


def pause_step_reset(batch: Batch) -> Measured:
    """Number of five criteria of the services that are met."""
    criteria = {}
    with simulation(batch, real_time_factor=2.0) as (_, _, observer):
        clock = observer.listen(topics.CLOCK)
        clock.wait(lambda sample: sample.stamp_ns > _NANO // 2)
        events = observer.listen(topics.EVENTS)
        since = len(events)
        answer = observer.call(topics.SIM_PAUSE, True)
        paused_ns = events.wait(
            lambda sample: any(s.name == SimulationEvent.PAUSED for s in sample.statuses), since
        ).stamp_ns
        count = len(clock)
        stepped = observer.call(topics.SIM_STEP)
        after = clock.wait(lambda sample: sample.stamp_ns > paused_ns, count).stamp_ns
        criteria["pause responds"] = answer.success
        criteria["paused, only a step advances time, by one tick"] = (
            stepped.success and after == paused_ns + _NANO // 100
        )
        observer.call(topics.SIM_PAUSE, False)
        drive_nut(observer, 0.1, 0.4, has_event(observer, PlantEvent.TAKE_OFF))
        bodies, count = observer.listen(topics.TRUTH_BODY1), len(clock)
        stamp = observer.time_ns()
        phases = observer.listen(topics.TRUTH_PHASE)
        since = len(phases)
        observer.call(topics.SIM_RESET_PLANT)
        observer.wait_for_text(topics.TRUTH_PHASE, PlantPhase.HELD, since=since)
        later = clock.wait(lambda sample: sample.stamp_ns > stamp, count).stamp_ns
        criteria["reset_plant resets the plant, time continues"] = later > stamp
        count, since = len(clock), len(bodies)
        criteria["reset responds"] = observer.call(topics.SIM_RESET).success
        zero = clock.wait(lambda sample: sample.stamp_ns < _NANO // 10, count).stamp_ns
        criteria["reset restarts time"] = zero < _NANO // 10
    details = {name: "met" if met else "not met" for name, met in criteria.items()}
    return Measured(sum(criteria.values()), "", details)


def divergence_stops(batch: Batch) -> Measured:
    """Number of three criteria of a diverged simulation that are met."""
    with simulation(batch, overrides=_DIVERGING) as (_, process, observer):
        bodies = observer.listen(topics.TRUTH_BODY1)
        observer.wait_for_text(topics.TRUTH_PHASE, PlantPhase.DIVERGED)
        event = observer.wait_for_event(PlantEvent.DIVERGED)
        count = len(bodies)
        samples = bodies.wait_for_count(count + 20)[count:]
        criteria = {
            "the event names the kept state": "plant_time" in event.values,
            "nothing moves": len({sample.position for sample in samples}) == 1,
            "the node runs on and exits with code 0": process.stop() == 0,
        }
    details = {name: "met" if met else "not met" for name, met in criteria.items()}
    return Measured(sum(criteria.values()), event.message, details)


def real_time_factor(batch: Batch) -> Measured:
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


def ends_cleanly(batch: Batch) -> Measured:
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


def state_rates(batch: Batch) -> Measured:
    """Largest relative deviation of a topic's period in simulated time from the contract."""
    with simulation(batch, _WITH_ALL_TOPICS, real_time_factor=1.0) as (_, _, observer):
        rows = [
            row
            for row in TOPICS.values()
            if row.name in ACCESS["sim_node"].publishes
            and row.rate
            and row.name != topics.SIM_STATUS
        ]
        feeds = {row.name: observer.listen(row.name) for row in rows}
        details = {}
        for row in rows:
            stamps = [sample.stamp_ns for sample in feeds[row.name].wait_for_count(42)][1:]
            period = (stamps[-1] - stamps[0]) / (len(stamps) - 1) * 1e-9
            assert row.rate is not None
            details[row.name] = abs(period * row.rate - 1.0)
    return Measured(max(details.values()), f"{len(details)} topics", details)


def command_timeout_stops_the_nut(batch: Batch) -> Measured:
    """Time that the nut moves after the last command [s of simulated time]."""
    with simulation(batch, real_time_factor=1.0) as (_, _, observer):
        nut = observer.listen(topics.JUMP_MOTOR_STATE)

        def moved() -> bool:
            return bool(nut.samples and nut.samples[-1].joints[JUMP_SCREW].position > 0.02)

        drive_nut(observer, 0.3, 0.05, moved)
        last_command_ns = observer.time_ns()
        observer.listen(topics.CLOCK).wait(
            lambda sample: sample.stamp_ns > last_command_ns + 2 * _NANO
        )
        moving = [s.stamp_ns for s in nut.samples if s.joints[JUMP_SCREW].velocity != 0.0]
    return Measured(max(0.0, (max(moving) - last_command_ns) * 1e-9), "contract: 0.5 s")


def bad_requests(batch: Batch) -> Measured:
    """Number of invalid requests that the jump controller does not refuse with a reason."""
    bad, total, details = 0, 0, {}
    with open_harness(batch.folder) as harness:
        process = harness.processes.start(JUMP)
        observer = harness.observer()
        observer.listen(topics.DIAGNOSTICS)
        observer.wait_for_event(NodeEvent.ACTIVE)
        for position, code in ((math.nan, "not_finite"), (9.0, "out_of_limits"), (0.1, "")):
            total += 1
            sample = JointSample(0, {JUMP_STROKE: JointValue(0.1, 0.1, 0.0)})
            message = JointMessage.of(sample)
            message.position[0] = position
            since = len(observer.listen(topics.DIAGNOSTICS))
            observer.publisher(topics.JUMP_REQUEST).publish(message.serialized())
            # The last request is valid, but no sensor data is available.
            status = observer.wait_for_status(topics.DIAGNOSTICS, _refusal_with(code), since)
            details[f"position {position:g}"] = status.message
            bad += not status.message
        bad += process.stop() != 0
    return Measured(bad, f"of {total} requests", details)


def _refusal_with(code: str) -> Callable[[Status], bool]:
    return lambda status: "code" in status.values and status.values["code"].startswith(code)
