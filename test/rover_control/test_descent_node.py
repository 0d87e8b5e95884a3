"""descent_node: pictures on the loop host, and as a process with winch and plant in lockstep."""

from __future__ import annotations

import json
import math
import signal
from typing import TYPE_CHECKING

import pytest
from graph import forbidden_to_controllers, subscriptions_of
from ros_messages import message_of

from msg_schemas import machine, topics
from msg_schemas.commands import CommandState
from msg_schemas.events import DescentEvent, WinchEvent
from msg_schemas.faults import Reason
from msg_schemas.phases import DescentPhase
from msg_schemas.samples import JointSample, JointValue, Sample
from rover_launch.plan import HANGING_DEFAULTS, LOCKSTEP, MOCK, TRUE
from rover_verify.harness.flight import DESCENT, Flight

if TYPE_CHECKING:
    from rover_verify.harness import NodeHarness

NODE, PROCESS = "descent_node", "rover_nodes"
QUICK: dict[str, object] = {
    "estimator_settling_time": 1.5,
    "steady_dwell": 0.3,
    "exposures": 2,
    "exposure_interval": 0.2,
}
START, FAR, RATE = 5.0, 20.0, 0.2  # [m]; a depth that is not reached; [m/s]


# ------------------------------------------------------------------------------------ the loop host


def test_a_stop_is_requested_by_topic_and_its_pictures_are_published():
    flight = Flight(DESCENT, "free_hang", {"tether.length": START}, parameters={NODE: QUICK})
    pictures: list[JointSample] = []

    def listen(_topic: str, sample: Sample, _sender: str, _now_ns: int) -> None:
        assert isinstance(sample, JointSample)
        pictures.append(sample)

    flight.host.exchange.listen(listen, topics.DESCENT_OBSERVATION)
    flight.run(1.0)
    assert flight.call(topics.WINCH_REARM).success
    flight.request(topics.DESCENT_REQUEST, machine.OBSERVATION_STOP, 5.5)
    assert flight.run(300.0, lambda: bool(flight.events_named(DescentEvent.STOP_COMPLETED)))
    for number, sample in enumerate(pictures, start=1):
        assert sample.joints[machine.PICTURE].position == number
        assert sample.joints[machine.DEPTH].position == pytest.approx(5.5, abs=0.05)
        assert math.radians(0.2) > sample.joints[machine.CAMERA_RATE].velocity >= 0.0
        assert machine.SMEAR in sample.joints
    (ended,) = flight.events_named(DescentEvent.STOP_COMPLETED)
    assert ended.values["pictures"] == str(len(pictures)) == "2"
    assert flight.call(topics.DESCENT_RELEASE).success
    assert flight.run(10.0, lambda: flight.phases[topics.DESCENT_PHASE] == DescentPhase.RELEASED)


# ---------------------------------------------------------------------------------------- processes


class Bench:
    """The mock plant, winch and descent in lockstep."""

    def __init__(self, harness: NodeHarness) -> None:
        from rover_verify.harness.launching import Launched, start_processes

        self._start, self._harness = start_processes, harness
        overrides = json.loads(HANGING_DEFAULTS["overrides"]) | {"tether.length": START}
        given = {
            "plant": MOCK,
            "overrides": json.dumps(overrides),
            LOCKSTEP: TRUE,
            "real_time_factor": "4",
        }
        self.launched = Launched(harness, DESCENT, given, {NODE: QUICK})
        self.observer = self.launched.observer
        self.process = self.launched.processes[PROCESS]
        for name in (topics.CLOCK, topics.WINCH_MODE, topics.WINCH_STATE, topics.WINCH_REQUEST):
            self.observer.listen(name)
        self.launched.wait_until_ready()

    def restart(self) -> None:
        planned = self.launched.planned
        (own,) = (each for each in planned.started if each.executable == PROCESS)
        (self.process,) = self._start(
            self._harness, type(planned)(planned.namespace, planned.log_level, (own,)),
            {NODE: QUICK},
        )  # fmt: skip

    def request(self, joint: str, depth: float, rate: float = 0.0) -> None:
        """Send a request without a stamp, as an operator does."""
        self.observer.send_joint(topics.DESCENT_REQUEST, joint, depth, rate, stamp_ns=0)

    def travel(self) -> None:
        """Arm, request a stop, and wait until the tether is paid out."""
        from rover_verify.harness.launching import arm_winch

        arm_winch(self.observer)
        # The mode reaches the descent up to some ticks later than the observer.
        self.observer.wait_for_time(self.observer.time_ns() + 100_000_000)
        self.request(machine.OBSERVATION_STOP, FAR, RATE)
        self.observer.wait_for_command(topics.DESCENT_REQUEST, CommandState.RUNNING)
        self.wait(lambda s: s.joints[machine.WINCH_DRUM].velocity > 0.95 * RATE)

    def wait(self, condition: object) -> JointSample:
        states = self.observer.listen(topics.WINCH_STATE)
        found = states.wait(condition, len(states))  # type: ignore[arg-type]
        assert isinstance(found, JointSample)
        return found

    def wait_until_braked(self) -> float:
        """Return the length at which the drum is braked [m]."""
        state = self.wait(
            lambda s: (
                s.joints[machine.WINCH_DRUM].velocity
                == 0.0
                == s.joints[machine.WINCH_BRAKE].position
            )
        )
        assert state.joints[machine.WINCH_DRUM].position < FAR - 0.1
        return state.joints[machine.WINCH_DRUM].position


@pytest.fixture
def bench(harness: NodeHarness) -> Bench:
    return Bench(harness)


@pytest.mark.ros
@pytest.mark.process
def test_refusals_state_value_limit_and_remedy_and_nothing_moves(bench: Bench):
    subscribed = subscriptions_of(bench.observer, NODE)
    assert topics.DESCENT_REQUEST in subscribed
    assert not subscribed & forbidden_to_controllers()

    def refused(code: str) -> str:
        return bench.observer.wait_for_refusal(topics.DESCENT_REQUEST, code).message

    bench.request(machine.OBSERVATION_STOP, 6.0)
    assert topics.WINCH_REARM in refused("not_armed")
    bench.request(machine.OBSERVATION_STOP, 60.0)
    assert "1.6 .. 48 m" in refused("out_of_limits")
    message = message_of(
        topics.DESCENT_REQUEST, JointSample(0, {machine.PLAIN_STOP: JointValue(6.0)})
    )
    message.position[0] = math.nan
    bench.observer.publisher(topics.DESCENT_REQUEST).publish(message)
    assert "plain_stop.position is nan" in refused("not_finite")
    for service in (topics.DESCENT_HOLD, topics.DESCENT_RESUME):
        answer = bench.observer.call(service)
        assert not answer.success
        assert "wrong_phase" in answer.message
    assert len(bench.observer.listen(topics.WINCH_REQUEST)) == 0


@pytest.mark.ros
@pytest.mark.process
def test_a_node_that_is_stopped_during_a_travel_leaves_the_drum_braked(bench: Bench):
    bench.travel()
    assert bench.process.stop(signal.SIGINT) == 0
    bench.wait_until_braked()
    assert bench.process.has_group_exited()
    assert "Traceback" not in bench.process.output


@pytest.mark.ros
@pytest.mark.process
def test_killed_the_winch_stops_by_itself_and_a_new_node_moves_only_on_request(bench: Bench):
    bench.travel()
    bench.process.send(signal.SIGKILL)
    bench.process.wait()
    bench.observer.wait_for_event(WinchEvent.MOTION_ABORTED, reason=Reason.RENEWAL_TIMEOUT)
    length = bench.wait_until_braked()
    since = len(bench.observer.listen(topics.DIAGNOSTICS))
    requests = len(bench.observer.listen(topics.WINCH_REQUEST))
    phases = len(bench.observer.listen(topics.DESCENT_PHASE))
    bench.restart()
    bench.observer.wait_until_ready(NODE, since)
    bench.observer.wait_for_text(topics.DESCENT_PHASE, DescentPhase.RELEASED, since=phases)
    bench.observer.wait_for_time(bench.observer.time_ns() + 2_000_000_000)
    assert len(bench.observer.listen(topics.WINCH_REQUEST)) == requests
    bench.request(machine.PLAIN_STOP, length + 0.3)
    bench.wait(lambda s: s.joints[machine.WINCH_DRUM].position > length + 0.2)
