"""Goals of actions as commands, and their records, without ROS."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from msg_schemas import topics
from msg_schemas.access import ACCESS, Act, nodes_that
from msg_schemas.actions import ACTIONS
from msg_schemas.cdr import pack
from msg_schemas.commands import CommandRecord, CommandState
from msg_schemas.faults import Reason
from msg_schemas.refusal import Refusal, RefusalCode
from msg_schemas.samples import JointSample, PoseSample
from msg_schemas.table import SERVICES, TOPICS
from rover_actions.followed_goal import REQUESTS, FollowedGoal, executing_node

NAME = "/action_node#1a"


def record(state: CommandState = CommandState.RUNNING, **changes: Any) -> CommandRecord:
    values = {
        "node": "descent_node",
        "subject": topics.DESCENT_REQUEST,
        "sender": "/action_node",
        "identifier": "1a",
        "taken_ns": 5,
    }
    return CommandRecord(**{**values, "state": state, **changes})


def test_each_action_has_its_command_its_node_and_its_rights():
    access = ACCESS["action_node"]
    assert access.executes == tuple(ACTIONS)
    for action in ACTIONS.values():
        granted = access.publishes if action.name in REQUESTS else access.calls
        assert action.command in granted
        assert action.command in (TOPICS if action.name in REQUESTS else SERVICES)
        assert action.hold in access.calls
        assert executing_node(action) in nodes_that(Act.SERVE, action.hold)


@pytest.mark.parametrize(
    ("name", "goal", "joint", "values"),
    [
        ("descend", {"depth": 12.0, "rate": 0.1, "observe": False}, "plain_stop", (12.0, 0.1)),
        ("descend", {"depth": 9.0, "rate": 0.0, "observe": True}, "observation_stop", (9.0, 0.0)),
        ("turn", {"angle": -1.5}, "heading_turn", (-1.5, 0.0)),
        ("jump", {"stroke": 0.1, "speed": 0.02}, "jump_stroke", (0.1, 0.02)),
    ],
)
def test_a_goal_is_the_request_of_an_operator(
    name: str, goal: dict[str, Any], joint: str, values: tuple[float, float]
):
    sample = REQUESTS[name](SimpleNamespace(**goal), 7)
    assert isinstance(sample, JointSample)
    ((found, value),) = sample.joints.items()
    assert (found, value[:2]) == (joint, values)
    assert pack(ACTIONS[name].command, sample, NAME)


def test_a_drive_goal_has_a_heading_only_where_it_is_given():
    place = SimpleNamespace(x=2.0, y=1.0, z=-60.0)
    free = REQUESTS["drive"](SimpleNamespace(position=place, with_heading=False, heading=1.0), 7)
    assert free == PoseSample(7, (2.0, 1.0, -60.0))
    turned = REQUESTS["drive"](
        SimpleNamespace(position=place, with_heading=True, heading=math.pi), 7
    )
    assert isinstance(turned, PoseSample)
    assert turned.orientation == pytest.approx((0.0, 0.0, 1.0, 0.0))
    with pytest.raises(Refusal, match="not_finite"):
        pack(
            topics.DRIVE_GOAL,
            REQUESTS["drive"](
                SimpleNamespace(position=place, with_heading=True, heading=math.inf), 7
            ),
        )


def test_a_goal_follows_its_record_alone_to_its_end():
    goal = FollowedGoal(ACTIONS["descend"], NAME)
    assert not goal.on_record(replace(record(), identifier="1b"))
    assert not goal.on_record(replace(record(), sender="/rover"))
    assert not goal.on_record(replace(record(), node="winch_node"))
    assert goal.on_record(record(CommandState.ACCEPTED))
    assert goal.end is None
    # The held command that a resume takes anew has another time of taking.
    assert not goal.on_record(record(taken_ns=6))
    ended = record(CommandState.DONE, reason=Reason.COMPLETED, text="there", result={"depth": "12"})
    assert goal.on_record(ended)
    assert goal.end is not None
    assert (goal.end.state, goal.end.reason, goal.end.text) == (
        CommandState.DONE, "completed", "there",
    )  # fmt: skip
    assert goal.end.values == {"depth": "12"}
    assert not goal.on_record(ended)


def test_a_refusal_ends_a_goal_with_its_code():
    goal = FollowedGoal(ACTIONS["descend"], NAME)
    refused = record(CommandState.REFUSED, reason=RefusalCode.NOT_ARMED, text="arm it")
    assert goal.on_record(refused)
    assert goal.end is not None
    assert (goal.end.state, goal.end.reason) == (CommandState.REFUSED, "not_armed")


def test_the_goal_of_a_call_takes_the_next_record_of_its_service():
    call = replace(record(), node="mission_node", subject=topics.MISSION_GO, sender="")
    now_ns, tick_ns = 5_000_000_000, 10_000_000
    earlier, same = replace(call, taken_ns=3), replace(call, taken_ns=now_ns)
    goal = FollowedGoal(ACTIONS["mission"], after_ns=now_ns, known={same.key})
    assert not goal.on_record(earlier)
    assert not goal.on_record(same)
    # In lockstep the node's clock may be a tick behind.
    own = replace(call, identifier="11", taken_ns=now_ns - tick_ns)
    assert goal.on_record(own)
    assert not goal.on_record(replace(call, identifier="12", taken_ns=now_ns + tick_ns))


def test_the_first_end_counts():
    goal = FollowedGoal(ACTIONS["descend"], NAME)
    goal.fail(CommandState.FAILED, "restarted", "descent_node has started again")
    goal.fail(CommandState.FAILED, "shutdown", "later")
    assert goal.end is not None
    assert goal.end.reason == "restarted"
    assert not goal.on_record(record())
