"""Any requests, goals, calls and life-cycle transitions move no drum and no spring unarmed."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from types import SimpleNamespace

import pytest
from contract_samples import samples_of
from damage import damaged
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from msg_schemas import topics
from msg_schemas.access import Act, nodes_that
from msg_schemas.actions import ACTIONS as SPECIFICATIONS
from msg_schemas.cdr import pack
from msg_schemas.machine import JUMP_SCREW, WINCH_BRAKE, WINCH_DRUM
from msg_schemas.refusal import Refusal
from msg_schemas.samples import JointSample, Sample
from msg_schemas.table import SERVICES, TOPICS
from rover_actions.followed_goal import REQUESTS as GOALS
from rover_launch.loop import make_plan, start_plan
from rover_launch.plan import HANGING_DEFAULTS
from rover_runtime.admission import read_message
from rover_runtime.loop_host import LoopHost
from rover_runtime.remote import OPERATOR, Sent
from rover_verify.harness.flight import MISSION

REQUESTS = sorted(
    name for name, row in TOPICS.items() if OPERATOR in nodes_that(Act.PUBLISH, row.name)
)
CALLED = sorted(
    name
    for name in SERVICES
    if name not in {topics.WINCH_REARM, topics.DRIVES_ARM}
    and not name.startswith(("sim/", "describe"))
)
LONGEST = 200  # ticks of an example


class Machine:
    """The mission's controllers with the mock plant, never armed."""

    def __init__(self) -> None:
        self.host = LoopHost()
        self.moved: list[Sample] = []
        self.last: dict[str, JointSample] = {}
        self.begin: dict[str, JointSample] = {}
        self.host.exchange.listen(self._on_state, topics.WINCH_STATE, topics.JUMP_MOTOR_STATE)
        given = {"plant": "mock", "scenario": "free_hang"}
        changed = {"mission_node": {"checkpoint": "none"}}
        start_plan(self.host, make_plan(MISSION, HANGING_DEFAULTS, given), changed)
        self.host.run(0.3)
        self.begin = dict(self.last)
        self.sequence = 0

    def _on_state(self, topic: str, sample: Sample, _sender: str, _now_ns: int) -> None:
        assert isinstance(sample, JointSample)
        self.last[topic] = sample

    def receive(self, topic: str, data: bytes) -> None:
        """Deliver bytes as a message of a stranger."""
        self.sequence += 1
        sent = Sent(topic, "stranger", self.sequence, self.host.exchange.ticks + 1)
        self.host.exchange.receive(sent, read_message(TOPICS[topic], data))

    def check(self) -> None:
        """Drum and spring have not moved, and every component lives."""
        drum = self.last[topics.WINCH_STATE].joints
        assert drum[WINCH_BRAKE].position == 0.0
        length = self.begin[topics.WINCH_STATE].joints[WINCH_DRUM].position
        assert drum[WINCH_DRUM].position == pytest.approx(length, abs=1e-6)
        # In its free travel the nut is the flywheel that turns a hanging rover.
        nut = self.last[topics.JUMP_MOTOR_STATE].joints[JUMP_SCREW].position
        assert nut < 0.0
        assert all(self.host[name].exit_code is None for name in self.host.names)


Action = Callable[[Machine], object]


def call(service: str, argument: bool) -> Action:
    def act(it: Machine) -> None:
        try:
            it.host.call(
                service, *([argument] if SERVICES[service].service.endswith("SetBool") else [])
            )
        except Refusal:
            return

    return act


def cycle(name: str) -> Action:
    def act(it: Machine) -> None:
        if it.host[name].active:
            it.host[name].deactivate()
        else:
            it.host[name].activate()

    return act


@st.composite
def messages(draw: st.DrawFn) -> Action:
    topic = draw(st.sampled_from(REQUESTS))
    data = pack(topic, draw(samples_of(TOPICS[topic])))
    if draw(st.booleans()):
        data = draw(damaged(data))
    return lambda it: it.receive(topic, data)


ANY = st.floats() | st.floats(-50.0, 50.0)


@st.composite
def goals(draw: st.DrawFn) -> Action:
    """Goals of actions, as `action_node` sends them."""
    name = draw(st.sampled_from([*GOALS]))
    place = SimpleNamespace(**{axis: draw(ANY) for axis in "xyz"})
    numbers = {each: draw(ANY) for each in ("depth", "rate", "angle", "stroke", "speed", "heading")}
    flags = {each: draw(st.booleans()) for each in ("observe", "with_heading")}
    goal = SimpleNamespace(position=place, **numbers, **flags)

    def act(it: Machine) -> None:
        topic = SPECIFICATIONS[name].command
        with contextlib.suppress(Refusal):
            it.receive(topic, pack(topic, GOALS[name](goal, it.host.now_ns())))

    return act


ACTIONS = st.one_of(
    messages(),
    goals(),
    st.builds(call, st.sampled_from(CALLED), st.booleans()),
    st.builds(cycle, st.sampled_from(MISSION)),
)


@pytest.mark.fuzz
@given(actions=st.lists(st.tuples(ACTIONS, st.integers(0, 5)), min_size=1, max_size=25))
@settings(max_examples=20, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
def test_nothing_lowers_or_tensions_a_machine_that_is_not_armed(actions: list[tuple[Action, int]]):
    machine = Machine()
    for act, ticks in actions:
        act(machine)
        for _ in range(ticks):
            machine.host.tick()
    machine.host.run(0.1)
    machine.check()
