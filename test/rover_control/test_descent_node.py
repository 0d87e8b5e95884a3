"""descent_node and winch_node as processes, with a simulated mother machine and rover."""

from __future__ import annotations

import math
import signal
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
from descent_mother import DescentMother
from graph import forbidden_to_controllers, subscriptions_of
from hanging_machine import WALL
from ros_messages import message_of
from winch_hoist import Hoist, HoistParameters

from msg_schemas import topics
from msg_schemas.events import DescentEvent, WinchEvent
from msg_schemas.faults import Reason
from msg_schemas.health import Health, read_health
from msg_schemas.phases import DescentPhase, HealthState, WinchMode
from msg_schemas.refusal import RefusalCode
from msg_schemas.samples import JointSample, JointValue, Level
from msg_schemas.table import (
    CAMERA_RATE,
    DEPTH,
    HEADING,
    OBSERVATION_STOP,
    PICTURE,
    PLAIN_STOP,
    SMEAR,
    SWING_MAJOR,
    WALL_DISTANCE,
)

if TYPE_CHECKING:
    from rover_verify.harness import NodeHarness, Observer, Process

pytestmark = [pytest.mark.ros, pytest.mark.process]

MODULE, NODE = "rover_control.hanging.descent_node", "descent_node"
WINCH, WINCH_NODE = "tether_winch.winch_node", "winch_node"
QUICK = {
    "estimator_settling_time": 1.5,
    "steady_dwell": 0.3,
    "exposures": 2,
    "exposure_interval": 0.2,
}
START = 5.0  # [m]
FAR = 20.0  # a depth that is not reached [m]


class Bench:
    """Both nodes with the simulated machine."""

    def __init__(self, harness: NodeHarness) -> None:
        self.harness = harness
        self.observer: Observer = harness.observer()
        for name in (
            topics.DIAGNOSTICS, topics.WINCH_MODE, topics.DESCENT_STATE,
            topics.DESCENT_OBSERVATION, topics.WINCH_REQUEST,
        ):  # fmt: skip
            self.observer.listen(name)
        hoist = Hoist(HoistParameters(start_length=START))
        hoist.step(None, 0.01)  # compiled here, not while time runs
        harness.processes.start(WINCH, {"use_sim_time": True})
        self.process = self.start()
        self.mother = DescentMother(self.observer, hoist, START)
        self.mother.begin()
        self.observer.wait_for_text(topics.WINCH_MODE, WinchMode.DISARMED)
        self.observer.wait_until_ready(WINCH_NODE)

    def start(self) -> Process:
        return self.harness.processes.start(MODULE, {"use_sim_time": True, **QUICK})

    def wait_until_ready(self, since: int = 0) -> None:
        self.observer.wait_until_ready(NODE, since)

    def arm(self) -> None:
        answer = self.observer.call(topics.WINCH_REARM)
        assert answer.success, answer.message
        self.observer.wait_for_text(topics.WINCH_MODE, WinchMode.HOLD)

    def request(self, joint: str, depth: float, rate: float = 0.0) -> None:
        """Send a request without a stamp, as an operator does."""
        self.observer.send_joint(topics.DESCENT_REQUEST, joint, depth, rate, stamp_ns=0)

    def request_and_wait(self, joint: str, depth: float, rate: float = 0.0) -> None:
        since = len(self.observer.listen(topics.EVENTS))
        self.request(joint, depth, rate)
        self.observer.wait_for_event(DescentEvent.STOP_ACCEPTED, since)
        self.mother.descends = True

    def travel(self) -> None:
        """Request a stop, and wait until the tether is paid out."""
        self.request_and_wait(OBSERVATION_STOP, FAR, 0.2)
        self.mother.wait(lambda: self.mother.last.rate > 0.19, "the drum does not pay out")

    def wait_until_braked(self) -> None:
        def braked() -> bool:
            last = self.mother.last
            return last.rate == 0.0 and not last.brake_is_open

        self.mother.wait(braked, "the drum is not braked")

    def refused(self, code: str, since: int = 0) -> str:
        return self.observer.wait_for_refusal(topics.DESCENT_REQUEST, code, since).message

    def diagnostics(self) -> int:
        return len(self.observer.listen(topics.DIAGNOSTICS))

    def phases(self) -> int:
        return len(self.observer.listen(topics.DESCENT_PHASE))


@pytest.fixture
def bench(harness: NodeHarness) -> Iterator[Bench]:
    made = Bench(harness)
    try:
        yield made
    finally:
        made.mother.end()


# Setting up a bench takes seconds, so each test covers several cases.


def test_a_stop_is_requested_by_topic_and_its_pictures_are_published(bench: Bench):
    refuse_what_is_wrong(bench)
    assert bench.observer.listen(topics.DESCENT_PHASE).wait().text == DescentPhase.RELEASED
    assert len(bench.observer.listen(topics.WHEEL_COMMAND)) == 0
    bench.request_and_wait(OBSERVATION_STOP, 5.5)
    bench.request_and_wait(PLAIN_STOP, 5.3, 0.1)
    look_at_pictures(bench)
    release(bench)
    be_stopped(bench)


def refuse_what_is_wrong(bench: Bench) -> None:
    """Refusals state value, limit and remedy, and nothing moves."""
    bench.mother.spoil = lambda name, m: None if name == topics.IMU else m
    bench.observer.wait_for_status(
        topics.DIAGNOSTICS,
        lambda s: read_health(s) == Health(NODE, HealthState.WAITING, (topics.IMU,)),
        bench.diagnostics(),  # it had not been received at the start either
    )
    bench.request(OBSERVATION_STOP, 6.0)
    assert f"{topics.IMU} timed out" in bench.refused("stale")
    bench.mother.spoil = lambda _, message: message
    bench.wait_until_ready(bench.diagnostics())
    bench.request(OBSERVATION_STOP, 6.0)
    assert topics.WINCH_REARM in bench.refused("not_armed")
    bench.arm()
    bench.request(OBSERVATION_STOP, 60.0)
    assert "1.6 .. 48 m" in bench.refused("out_of_limits")
    good = JointSample(bench.mother.now_ns, {PLAIN_STOP: JointValue(6.0)})
    message = message_of(topics.DESCENT_REQUEST, good)
    message.position[0] = math.nan
    bench.observer.publisher(topics.DESCENT_REQUEST).publish(message)
    assert "plain_stop.position is nan" in bench.refused("not_finite")
    bench.mother.wait(lambda: bench.mother.time > 4.0, "time does not run")
    stale = JointSample(bench.mother.now_ns - 2_900_000_000, good.joints)
    bench.observer.send(topics.DESCENT_REQUEST, stale)
    bench.observer.wait_for_refusal(topics.DESCENT_REQUEST, RefusalCode.STALE)
    for service in (topics.DESCENT_HOLD, topics.DESCENT_RESUME):
        answer = bench.observer.call(service)
        assert not answer.success
        assert "wrong_phase" in answer.message
    assert bench.mother.last.length == START
    assert len(bench.observer.listen(topics.WINCH_REQUEST)) == 0
    subscribed = subscriptions_of(bench.observer, NODE)
    assert {topics.IMU, topics.WINCH_STATE} <= subscribed
    assert not subscribed & forbidden_to_controllers()


def look_at_pictures(bench: Bench) -> None:
    observations = bench.observer.listen(topics.DESCENT_OBSERVATION)
    for number, sample in enumerate(observations.wait_for_count(2), start=1):
        assert sample.joints[PICTURE].position == number
        assert sample.joints[DEPTH].position == pytest.approx(5.5, abs=0.02)
        assert sample.joints[WALL_DISTANCE].position == WALL
        assert math.radians(0.2) > sample.joints[CAMERA_RATE].velocity >= 0.0
        assert abs(sample.joints[HEADING].position) < 0.1
        # A report of the camera whose exposure began at the command or later.
        assert sample.joints[SMEAR].position * 1e3 - sample.stamp_ns * 1e-9 >= 0.1 - 1e-6
    ended = bench.observer.wait_for_event(DescentEvent.STOP_COMPLETED)
    assert ended.values["pictures"] == "2"
    bench.observer.wait_for_status(
        topics.EVENTS,
        lambda s: s.name == DescentEvent.STOP_COMPLETED and s.values["depth"] == "5.3",
    )
    state = bench.observer.listen(topics.DESCENT_STATE)
    state.wait(lambda s: abs(s.joints[DEPTH].position - 5.3) < 0.02)
    assert state.last.joints[SWING_MAJOR].position < math.radians(1.0)


def release(bench: Bench) -> None:
    bench.mother.descends = False
    since = bench.phases()
    answer = bench.observer.call(topics.DESCENT_RELEASE)
    assert answer.success, answer.message
    bench.observer.wait_for_text(topics.DESCENT_PHASE, DescentPhase.RELEASED, since=since)


def be_stopped(bench: Bench) -> None:
    """A node that is stopped during a travel leaves the drum braked."""
    bench.travel()
    bench.mother.descends = False
    assert bench.process.stop(signal.SIGINT) == 0
    bench.wait_until_braked()
    assert bench.mother.last.length < FAR - 0.1
    assert bench.process.has_group_exited()
    assert "Traceback" not in bench.process.output


def test_after_an_interruption_it_moves_only_on_request(bench: Bench):
    bench.wait_until_ready()
    bench.arm()
    hold_resume_and_abort(bench)
    lose_a_sensor(bench)
    be_killed(bench)


def hold_resume_and_abort(bench: Bench) -> None:
    bench.travel()
    assert bench.observer.call(topics.DESCENT_HOLD).success
    bench.wait_until_braked()
    held = bench.mother.last.length
    bench.request(PLAIN_STOP, 6.0)
    assert "resume it first" in bench.refused("wrong_phase")
    assert bench.observer.call(topics.DESCENT_RESUME).success
    bench.mother.wait(lambda: bench.mother.last.length > held + 0.2, "it does not go on")
    answer = bench.observer.call(topics.DESCENT_ABORT)
    assert answer.success
    assert "1 stops" in answer.message
    bench.wait_until_braked()
    assert bench.mother.last.length < FAR - 0.1
    again = bench.observer.call(topics.DESCENT_RESUME)
    assert not again.success
    assert topics.DESCENT_RESUME in again.message


def lose_a_sensor(bench: Bench) -> None:
    """A sensor timeout ends in a hold with the reason."""
    bench.travel()
    bench.mother.descends = False
    bench.mother.spoil = lambda name, m: None if name == topics.IMU else m
    event = bench.observer.wait_for_event(DescentEvent.INTERRUPTED)
    assert event.level is Level.WARN
    assert topics.IMU in event.message
    assert event.values["reason"] == Reason.SENSOR_TIMEOUT
    bench.wait_until_braked()
    assert bench.mother.last.length < FAR - 0.1
    bench.mother.spoil = lambda _, message: message
    bench.wait_until_ready(bench.diagnostics())
    bench.mother.wait_for(QUICK["estimator_settling_time"])  # the swing must be learnt anew
    answer = bench.observer.call(topics.DESCENT_RESUME)
    assert answer.success, answer.message
    bench.mother.descends = True
    bench.mother.wait(lambda: bench.mother.last.rate > 0.19, "it does not go on")


def be_killed(bench: Bench) -> None:
    """The winch stops by itself, and a restarted node moves nothing."""
    bench.mother.descends = False
    bench.process.send(signal.SIGKILL)
    bench.process.wait()
    bench.observer.wait_for_event(WinchEvent.MOTION_ABORTED, reason=Reason.RENEWAL_TIMEOUT)
    bench.wait_until_braked()
    length = bench.mother.last.length
    assert length < FAR - 0.1
    since, requests = bench.diagnostics(), len(bench.observer.listen(topics.WINCH_REQUEST))
    phases = bench.phases()
    bench.start()
    bench.wait_until_ready(since)
    bench.observer.wait_for_text(topics.DESCENT_PHASE, DescentPhase.RELEASED, since=phases)
    bench.mother.wait_for(2.0)
    assert bench.mother.last.length == length
    assert len(bench.observer.listen(topics.WINCH_REQUEST)) == requests
    bench.request_and_wait(PLAIN_STOP, length + 0.3)
    bench.mother.wait(lambda: bench.mother.last.length > length + 0.2, "it does not go on")
