"""The table of commands keeps the contract and refuses what the contract refuses."""

import math

import pytest

from msg_schemas import topics
from msg_schemas.access import Act, node_that
from msg_schemas.cdr import check
from msg_schemas.fields import FieldError
from msg_schemas.samples import (
    IDENTITY,
    NO_ORIENTATION,
    ZERO,
    JointSample,
    JointValue,
    PoseEstimateSample,
)
from msg_schemas.table import SERVICES
from operator_console.commands import COMMANDS, OperatorCommand, Order

ORIGIN = PoseEstimateSample(7, ZERO, IDENTITY)
REQUESTS = [row for row in COMMANDS.values() if row.request is not None]


def ordered(command: OperatorCommand, share: float) -> Order:
    """An order whose arguments lie at a share between their limits."""
    values: dict[str, object] = {}
    for argument in command.arguments:
        rule = command.rule(argument)
        values[argument.name] = rule.minimum + share * (rule.maximum - rule.minimum)
    return command.order(values)


@pytest.mark.parametrize("command", REQUESTS, ids=lambda row: row.name)
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_arguments_within_the_limits_keep_the_contract(command: OperatorCommand, share: float):
    assert command.request is not None
    order = ordered(command, share)
    sample = order.goal(ORIGIN, 5) if command.request.is_relative else order.sample()
    check(command.request.topic, sample)


@pytest.mark.parametrize("command", REQUESTS, ids=lambda row: row.name)
def test_arguments_beyond_the_limits_are_refused_with_the_limits(command: OperatorCommand):
    for argument in command.arguments:
        rule = command.rule(argument)
        given = {a.name: command.rule(a).maximum for a in command.arguments if a.required}
        for wrong in (
            math.nextafter(rule.maximum, math.inf),
            math.nextafter(rule.minimum, -math.inf),
        ):
            with pytest.raises(FieldError, match=f"at most {rule.maximum:g}"):
                command.order({**given, argument.name: wrong})


@pytest.mark.parametrize("given", ["nan", "inf", "-inf", "deep", "", "1,5", True, [1.0], math.nan])
def test_an_argument_that_is_no_number_is_refused(given: object):
    with pytest.raises(FieldError, match=r"depth = .*should be a number at least 0"):
        COMMANDS["descend"].order({"depth": given})


def test_a_missing_argument_is_named_with_its_unit():
    with pytest.raises(FieldError, match=r"stroke = null: should be a number at least 0\.005.* m"):
        COMMANDS["jump"].order({})


def test_an_unknown_argument_is_refused():
    with pytest.raises(FieldError, match="did you mean 'depth'"):
        COMMANDS["descend"].order({"dept": 3.0})
    with pytest.raises(FieldError, match="hold has no such argument"):
        COMMANDS["hold"].order({"depth": 3.0})


def test_a_text_is_read_as_a_number_and_missing_arguments_are_the_node_s_defaults():
    order = COMMANDS["descend"].order({"depth": "30"})
    assert order.sample() == JointSample(0, {"plain_stop": JointValue(30.0, 0.0, 0.0)})
    assert order.text == "descend 30"


def test_an_angle_is_given_in_degrees_and_sent_in_radians():
    order = COMMANDS["turn"].order({"angle": "-90"})
    assert order.sample().joints["heading_turn"].position == pytest.approx(-math.pi / 2)
    assert order.contract_values["angle"] == pytest.approx(-math.pi / 2)
    assert order.text == "turn -90"


def test_a_distance_ahead_is_along_the_heading_and_leaves_the_heading_open():
    half = math.radians(60.0) / 2.0
    turned = (0.0, 0.0, math.sin(half), math.cos(half))
    pose = PoseEstimateSample(7, (1.0, 2.0, -40.0), turned)
    goal = COMMANDS["drive"].order({"distance": 2.0}).goal(pose, 9)
    assert goal.stamp_ns == 9
    assert goal.position == pytest.approx((2.0, 2.0 + math.sqrt(3.0), -40.0))
    assert goal.orientation == NO_ORIENTATION
    with pytest.raises(FieldError, match=r"distance = 0: should be a number at least 0\.05"):
        COMMANDS["drive"].order({"distance": 0})


def test_switch_services_get_data_and_triggers_none():
    calls = [call for row in COMMANDS.values() for call in row.calls]
    assert calls
    for call in calls:
        takes_switch = SERVICES[call.service].service.endswith("SetBool")
        assert (call.data is not None) == takes_switch, call


def test_a_command_is_a_request_or_calls_and_every_request_can_be_undone():
    for row in COMMANDS.values():
        assert bool(row.calls) != (row.request is not None), row.name
        assert row.undo in {"", *COMMANDS}
        if row.request is not None:
            assert row.moves, row.name
            assert row.undo, row.name
        if row.undo:
            assert not COMMANDS[row.undo].moves, row.name
        assert row.lasts <= (len(row.calls) == 1 and bool(row.undo)), row.name


def test_requests_that_the_contract_times_out_are_renewed():
    renewed = {row.request.joint for row in REQUESTS if row.request and row.request.renewal_rate}
    assert renewed == {"winch_rate", "winch_tension"}
    assert {row.request.node for row in REQUESTS if row.request} == {
        node_that(Act.PUBLISH, topic)
        for topic in (
            topics.WINCH_MODE,
            topics.DESCENT_PHASE,
            topics.JUMP_PHASE,
            topics.DRIVE_PHASE,
        )
    }


def test_the_text_of_an_order_is_what_an_operator_types():
    order = COMMANDS["payout"].order({"length": 12, "rate": 0.05})
    assert order.text == "payout 12 --rate 0.05"


def test_a_depth_on_the_other_side_contradicts_the_command():
    down, up = COMMANDS["descend"].order({"depth": 5}), COMMANDS["ascend"].order({"depth": 5})
    assert down.contradiction(3.0) == up.contradiction(7.0) == ""
    assert down.contradiction(7.0) == "the rover is at 7.00 m, 5 m is above it; `ascend 5`?"
    assert up.contradiction(3.0) == "the rover is at 3.00 m, 5 m is below it; `descend 5`?"
    assert COMMANDS["observe"].order({"depth": 5}).contradiction(7.0) == ""


def test_a_call_names_every_node_that_may_serve_it():
    (pause,) = COMMANDS["pause"].calls
    assert set(pause.servers) == {"sim_node", "mock_plant"}
    assert all(call.servers for row in COMMANDS.values() for call in row.calls)
