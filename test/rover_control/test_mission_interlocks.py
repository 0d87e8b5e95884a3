"""The table of interlocks: what it says, how each condition is seen, and that it is kept."""

from __future__ import annotations

import random

import pytest
from mission_machine import MissionMachine

from msg_schemas import topics
from msg_schemas.machine import JUMP_SCREW, PAYOUT, TENSION, TETHER_OUT
from msg_schemas.samples import JointSample, JointValue, OdometrySample, TextSample
from rover_control.mission_interlocks import (
    INTERLOCKS,
    Act,
    Condition,
    forbidden,
    holds,
    remedy,
)
from rover_control.mission_legs import Ask, MissionPhase
from rover_control.observed_state import ObservedState

NOW = 10.0
NOW_NS = round(NOW * 1e9)

# Rows: conditions; columns: descend, lower, lift, drive, slacken, jump. x = it must not be.
TABLE = """
WINCH_SILENT  x x x x x x
DRIVE_SILENT  . . . x . .
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
MOVING = (Act.DESCEND, Act.LOWER, Act.LIFT, Act.DRIVE, Act.SLACKEN, Act.JUMP)


def rows() -> list[tuple[Condition, Act, bool]]:
    found = []
    for line in TABLE.strip().splitlines():
        name, *marks = line.split()
        found += [
            (Condition[name], act, mark == "x") for act, mark in zip(MOVING, marks, strict=True)
        ]
    return found


def observed(
    winch: str = "hold", descent: str = "released", drive: str = "released", jump: str = "standby",
    nut: float = -0.03, pull: float = 0.5, stands: bool = True, heard: bool = True,
) -> ObservedState:  # fmt: skip
    made = ObservedState(2.0)
    for name, word in (
        (topics.WINCH_MODE, winch),
        (topics.DESCENT_PHASE, descent),
        (topics.DRIVE_PHASE, drive),
        (topics.JUMP_PHASE, jump),
    ):
        made.hear(name, TextSample(word), 0)
    made.hear(topics.WINCH_ALARMS, JointSample(0, {"touchdown": JointValue(float(stands))}), 0)
    made.hear(topics.JUMP_MOTOR_STATE, JointSample(0, {JUMP_SCREW: JointValue(nut)}), 0)
    told = NOW_NS if heard else 0
    joints = {
        PAYOUT: JointValue(9.0),
        TENSION: JointValue(1.0, 0.0, pull + 0.1),
        TETHER_OUT: JointValue(0.0, 0.0, 0.1),
    }
    made.hear(topics.WINCH_ESTIMATE, JointSample(0, joints), told)
    zero = (0.0, 0.0, 0.0)
    made.hear(topics.ODOMETRY, OdometrySample(0, zero, (0.0, 0.0, 0.0, 1.0), zero, zero), told)
    return made


SEEN: dict[Condition, dict[str, object]] = {
    Condition.WINCH_SILENT: {"heard": False},
    Condition.DRIVE_SILENT: {"heard": False},
    Condition.STOPPED: {"winch": "stop"},
    Condition.FAULT: {"winch": "fault"},
    Condition.UNARMED: {"winch": "disarmed"},
    Condition.FLYING: {"jump": "flight"},
    Condition.JUMP_FAULT: {"jump": "fault"},
    Condition.COMPRESSED: {"jump": "compressing"},
    Condition.DRIVING: {"drive": "turning"},
    Condition.DESCENT: {"descent": "damping"},
    Condition.STANDING: {"stands": True},
    Condition.HANGING: {"stands": False},
    Condition.TAUT: {"pull": 5.0},
}


@pytest.mark.parametrize(("condition", "act", "is_forbidden"), rows())
def test_the_table_says_what_is_written_here(condition: Condition, act: Act, is_forbidden: bool):
    assert (condition in INTERLOCKS[act]) is is_forbidden


@pytest.mark.parametrize("condition", Condition)
def test_each_condition_is_seen_where_it_is_so_and_not_elsewhere(condition: Condition):
    assert holds(condition, observed(**SEEN[condition]), NOW)  # type: ignore[arg-type]
    other = {"stands": condition is not Condition.STANDING}
    assert not holds(condition, observed(**other), NOW)  # type: ignore[arg-type]


@pytest.mark.parametrize(("condition", "act", "is_forbidden"), rows())
def test_what_is_forbidden_is_found(condition: Condition, act: Act, is_forbidden: bool):
    stands = act not in (Act.DESCEND, Act.LOWER)
    seen = observed(**({"stands": stands} | SEEN[condition]))  # type: ignore[arg-type]
    assert not is_forbidden or forbidden(act, seen, NOW) is not None


@pytest.mark.parametrize("act", MOVING)
def test_each_act_may_be_where_nothing_is_in_its_way(act: Act):
    assert forbidden(act, observed(stands=act is not Act.DESCEND), NOW) is None


def test_a_nut_below_the_latch_counts_as_holding_the_spring():
    assert holds(Condition.COMPRESSED, observed(nut=0.1), NOW)
    assert not holds(Condition.COMPRESSED, observed(nut=0.0), NOW)


def test_a_tension_that_is_not_known_forbids_a_jump():
    assert holds(Condition.TAUT, observed(pull=float("nan")), NOW)


def test_what_an_operator_has_stopped_nothing_but_people_clear():
    assert remedy(Condition.STOPPED, observed(winch="stop")) == ""
    assert remedy(Condition.UNARMED, observed()) == topics.WINCH_REARM
    assert remedy(Condition.COMPRESSED, observed(nut=0.1)) == topics.JUMP_ABORT
    assert remedy(Condition.COMPRESSED, observed(jump="letting_down")) == ""
    assert remedy(Condition.DRIVING, observed()) == topics.DRIVE_STOP
    assert remedy(Condition.DESCENT, observed(descent="standby")) == topics.DESCENT_RELEASE
    assert remedy(Condition.DESCENT, observed(descent="damping")) == topics.DESCENT_ABORT


ACT_OF = {
    topics.DESCENT_REQUEST: (Act.DESCEND,),
    topics.WINCH_REQUEST: (Act.LOWER, Act.LIFT, Act.SLACKEN),
    topics.DRIVE_GOAL: (Act.DRIVE,),
    topics.DRIVE_START: (Act.DRIVE,),
    topics.JUMP_REQUEST: (Act.JUMP,),
}


@pytest.mark.parametrize("seed", range(12))
def test_a_mission_never_asks_for_what_is_forbidden_whatever_it_is_told(seed: int):
    generator = random.Random(seed)
    machine = MissionMachine()
    machine.say()
    machine.mission.go(machine.now_ns)
    asked: list[Ask] = []
    take = machine.take

    def checked(ask: Ask) -> None:
        asked.append(ask)
        acts = ACT_OF.get(ask.name, ())
        if acts:
            seen, now = machine.mission.observed, machine.now
            assert any(forbidden(act, seen, now) is None for act in acts), (ask, seed)
        take(ask)

    machine.take = checked  # type: ignore[method-assign]
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
            machine.mission.resume(machine.now_ns)
    assert len(asked) > 10
