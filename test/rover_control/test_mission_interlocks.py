"""Interlocks: the table, the detection of each condition, and their enforcement."""

from __future__ import annotations

import random

import pytest
from mission_machine import MissionMachine

from msg_schemas import topics
from msg_schemas.machine import JUMP_SCREW, PAYOUT, TENSION, TETHER_OUT
from msg_schemas.phases import MissionPhase
from msg_schemas.samples import JointSample, JointValue, PoseEstimateSample, TextSample
from rover_control.mission.mission_interlocks import (
    INTERLOCKS,
    Condition,
    RequestedAction,
    applies,
    remedy,
    violated_interlock,
)
from rover_control.mission.mission_legs import LegRequest
from rover_control.mission.observed_state import ObservedState

NOW = 10.0
NOW_NS = round(NOW * 1e9)

# Rows: conditions; columns: descend, lower, lift, drive, slacken, jump. x = forbidden.
TABLE = """
WINCH_STALE   x x x x x x
DRIVE_STALE   . . . x . .
STOPPED       x x x x x x
FAULT         x x x x x x
UNARMED       x x x x x x
FLYING        x x x x x x
JUMP_FAULT    x x x x x x
COMPRESSED    x x x x x x
DRIVING       x x x . x x
DESCENT       . x x x x x
STANDING      x . . . . .
HANGING       . . . x x x
TAUT          . . . . . x
"""
MOVING = (
    RequestedAction.DESCEND,
    RequestedAction.LOWER,
    RequestedAction.LIFT,
    RequestedAction.DRIVE,
    RequestedAction.SLACKEN,
    RequestedAction.JUMP,
)


def rows() -> list[tuple[Condition, RequestedAction, bool]]:
    found = []
    for line in TABLE.strip().splitlines():
        name, *marks = line.split()
        found += [
            (Condition[name], action, mark == "x")
            for action, mark in zip(MOVING, marks, strict=True)
        ]
    return found


def observed(
    winch: str = "hold", descent: str = "released", drive: str = "released", jump: str = "standby",
    nut: float = -0.03, net_tension: float = 0.5, on_floor: bool = True, fresh: bool = True,
) -> ObservedState:  # fmt: skip
    made = ObservedState(2.0)
    for name, word in (
        (topics.WINCH_MODE, winch),
        (topics.DESCENT_PHASE, descent),
        (topics.DRIVE_PHASE, drive),
        (topics.JUMP_PHASE, jump),
    ):
        made.receive(name, TextSample(word), 0)
    made.receive(topics.WINCH_ALARMS, JointSample(0, {"touchdown": JointValue(float(on_floor))}), 0)
    made.receive(topics.JUMP_MOTOR_STATE, JointSample(0, {JUMP_SCREW: JointValue(nut)}), 0)
    received_ns = NOW_NS if fresh else 0
    joints = {
        PAYOUT: JointValue(9.0),
        TENSION: JointValue(1.0, 0.0, net_tension + 0.1),
        TETHER_OUT: JointValue(0.0, 0.0, 0.1),
    }
    made.receive(topics.WINCH_ESTIMATE, JointSample(0, joints), received_ns)
    made.receive(topics.POSE, PoseEstimateSample(0, (0.0, 0.0, 0.0)), received_ns)
    return made


SEEN: dict[Condition, dict[str, object]] = {
    Condition.WINCH_STALE: {"fresh": False},
    Condition.DRIVE_STALE: {"fresh": False},
    Condition.STOPPED: {"winch": "stop"},
    Condition.FAULT: {"winch": "fault"},
    Condition.UNARMED: {"winch": "disarmed"},
    Condition.FLYING: {"jump": "flight"},
    Condition.JUMP_FAULT: {"jump": "fault"},
    Condition.COMPRESSED: {"jump": "compressing"},
    Condition.DRIVING: {"drive": "turning"},
    Condition.DESCENT: {"descent": "damping"},
    Condition.STANDING: {"on_floor": True},
    Condition.HANGING: {"on_floor": False},
    Condition.TAUT: {"net_tension": 5.0},
}


@pytest.mark.parametrize(("condition", "action", "is_forbidden"), rows())
def test_the_interlock_table_is_as_specified(
    condition: Condition, action: RequestedAction, is_forbidden: bool
):
    assert (condition in INTERLOCKS[action]) is is_forbidden


@pytest.mark.parametrize("condition", Condition)
def test_each_condition_applies_only_where_it_should(condition: Condition):
    assert applies(condition, observed(**SEEN[condition]), NOW)  # type: ignore[arg-type]
    other = {"on_floor": condition is not Condition.STANDING}
    assert not applies(condition, observed(**other), NOW)  # type: ignore[arg-type]


@pytest.mark.parametrize(("condition", "action", "is_forbidden"), rows())
def test_a_forbidden_action_has_a_violated_interlock(
    condition: Condition, action: RequestedAction, is_forbidden: bool
):
    on_floor = action not in (RequestedAction.DESCEND, RequestedAction.LOWER)
    state = observed(**({"on_floor": on_floor} | SEEN[condition]))  # type: ignore[arg-type]
    assert not is_forbidden or violated_interlock(action, state, NOW) is not None


@pytest.mark.parametrize("action", MOVING)
def test_each_action_is_allowed_without_conditions(action: RequestedAction):
    assert (
        violated_interlock(action, observed(on_floor=action is not RequestedAction.DESCEND), NOW)
        is None
    )


def test_a_nut_below_the_latch_counts_as_holding_the_spring():
    assert applies(Condition.COMPRESSED, observed(nut=0.1), NOW)
    assert not applies(Condition.COMPRESSED, observed(nut=0.0), NOW)


def test_an_unknown_tension_forbids_a_jump():
    assert applies(Condition.TAUT, observed(net_tension=float("nan")), NOW)


def test_a_winch_stopped_by_an_operator_has_no_remedy():
    assert remedy(Condition.STOPPED, observed(winch="stop")) == ""
    assert remedy(Condition.UNARMED, observed()) == topics.WINCH_REARM
    assert remedy(Condition.COMPRESSED, observed(nut=0.1)) == topics.JUMP_ABORT
    assert remedy(Condition.COMPRESSED, observed(jump="letting_down")) == ""
    assert remedy(Condition.DRIVING, observed()) == topics.DRIVE_STOP
    assert remedy(Condition.DESCENT, observed(descent="standby")) == topics.DESCENT_RELEASE
    assert remedy(Condition.DESCENT, observed(descent="damping")) == topics.DESCENT_ABORT


ACT_OF = {
    topics.DESCENT_REQUEST: (RequestedAction.DESCEND,),
    topics.WINCH_REQUEST: (RequestedAction.LOWER, RequestedAction.LIFT, RequestedAction.SLACKEN),
    topics.DRIVE_GOAL: (RequestedAction.DRIVE,),
    topics.DRIVE_START: (RequestedAction.DRIVE,),
    topics.JUMP_REQUEST: (RequestedAction.JUMP,),
}


@pytest.mark.parametrize("seed", range(12))
def test_a_mission_never_sends_a_forbidden_request(seed: int):
    generator = random.Random(seed)
    machine = MissionMachine()
    machine.publish()
    machine.operator.go(machine.now_ns)
    sent: list[LegRequest] = []
    handle = machine.handle

    def checked(request: LegRequest) -> None:
        sent.append(request)
        acts = ACT_OF.get(request.name, ())
        if acts:
            state, now = machine.mission.observed, machine.now
            assert any(violated_interlock(action, state, now) is None for action in acts), (
                request,
                seed,
            )
        handle(request)

    machine.handle = checked  # type: ignore[method-assign]
    for _ in range(3000):
        if generator.random() < 0.02:
            what = generator.choice(("winch", "descent", "drive", "jump", "nut", "stuck"))
            value: object = {
                "winch": generator.choice(("disarmed", "fault", "hold", "tension", "slack")),
                "descent": generator.choice(("released", "standby", "damping")),
                "drive": generator.choice(("released", "standing", "driving", "failed")),
                "jump": generator.choice(("standby", "compressing", "letting_down", "fault")),
                "nut": generator.choice((-0.03, 0.0, 0.1)),
                "stuck": 2,
            }[what]
            setattr(machine, what, value)
        machine.tick()
        if machine.mission.phase is MissionPhase.HOLDING and machine.mission.leg is not None:
            machine.operator.resume(machine.now_ns)
    assert len(sent) > 10
