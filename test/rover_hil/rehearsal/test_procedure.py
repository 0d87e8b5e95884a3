"""Procedures are read; an invalid one is refused with file, step, key, value and expectation."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from msg_schemas import topics
from msg_schemas.configuration import read
from msg_schemas.shipped import ShippedError
from msg_schemas.table import TOPICS
from rover_hil.rehearsal.actions import ACTIONS, BeyondLimits, Publish
from rover_hil.rehearsal.expectation_result import InterfaceRule
from rover_hil.rehearsal.expectations import EXPECTATIONS
from rover_hil.rehearsal.procedure import load_procedure, shipped

DOCUMENT = Path(__file__).parents[3] / "docs" / "hil.md"
HEAD = "about: a trial\nsteps:\n  first:\n    rule: rate\n    title: the rate is kept\n"


def doing(action: str) -> str:
    """A procedure of one step that does this."""
    return f"{HEAD}    do: [{{{action}}}]\n    expect: [{{event: {{name: drives_armed}}}}]\n"


def expecting(expectation: str) -> str:
    """A procedure of one step that expects this."""
    return f"{HEAD}    expect: [{{{expectation}}}]\n"


def loaded(folder: Path, text: str) -> str:
    path = folder / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    return str(path)


@pytest.mark.parametrize("name", shipped())
def test_the_package_s_procedures_are_valid(name: str):
    found = load_procedure(name)
    assert found.name == name
    assert found.procedure.steps
    assert len(found.digest) == 64


def test_the_interface_check_tests_every_rule_of_the_contract():
    steps = load_procedure("interface_check").procedure.steps.values()
    assert {step.rule for step in steps} == set(InterfaceRule)


def test_the_interface_check_starts_without_motion_and_disarms_before_it_commands():
    steps = list(load_procedure("interface_check").procedure.steps.items())
    still = [name for name, step in steps if not step.moves]
    assert [name for name, _ in steps][: len(still)] == still
    assert all("disarmed" in step.after or "armed_and_still" in step.after
               for name, step in steps if step.moves)  # fmt: skip


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("about: [", "is not YAML"),
        ("about: nothing\n", "steps = null: missing"),
        (HEAD.replace("rate\n", "speed\n"), "steps.first.rule = 'speed': should be one of rate"),
        (HEAD + "    dos: []\n", "steps.first.dos = []: no such key; did you mean 'do'?"),
        (HEAD, "steps.first.expect = null: missing; a step without expectations cannot fail"),
        (doing("wait: {duratoin: 1}"), "steps.first.do[0].wait.duratoin = 1: no such key"),
        (doing("wait: {duration: -1}"), "wait.duration = -1: should be a number at least 0"),
        (
            doing("wiat: {duration: 1}"),
            "do[0].wiat = {'duration': 1}: no such key; did you mean 'wait'?",
        ),
        (doing("wait: {duration: 1}, call: {}"), "should be a mapping of one of wait"),
        (
            expecting("rate: {topics: winch/stat, minimum: 1}"),
            "expect[0].rate.topics = 'winch/stat': no such topic; did you mean 'winch/state'?",
        ),
        (
            expecting("rate: {topics: winch/state, minimum: 1}"),
            "covers the time of the actions, which is zero: add a wait",
        ),
        (
            HEAD + "    do: [{wait: {duration: 1}}]\n"
            "    expect: [{no_messages: {topics: winch/state, after: 2}}]\n",
            "covers the time of the actions, which is 1 s, from 2 s on: add a wait",
        ),
        (
            expecting("metric: {status: 'hil_bridge: winch', key: armed, equals: true}"),
            "metric.equals = True: should be a number, or a text in quotes",
        ),
        (
            expecting("event: {name: drive_tripped, values: {device: true}}"),
            "event.values.device = True: should be a number, or a text in quotes",
        ),
        (
            expecting("rate: {topics: winch/state}"),
            "rate.minimum = null: missing; give minimum, maximum or both",
        ),
        (
            expecting("value: {topic: winch/state, field: drum.velocity, minimum: 0}"),
            "value.field = 'drum.velocity': winch/state has no such field; did you mean",
        ),
        (
            expecting("value: {topic: winch/state, field: winch_drum.velocity, minimum: 2, "
                      "maximum: 1}"),
            "value.minimum = 2.0: should be at most the maximum, 1",
        ),
        (
            expecting("text: {topic: winch/mode, one_of: holding}"),
            "text.one_of = 'holding': should be one of disarmed, hold",
        ),
        (
            expecting("text: {topic: robot_description}"),
            "text.one_of = null: missing; should be a text, or a list of them",
        ),
        (
            expecting("event: {name: drives_armed, since: mark}"),
            "expect[0].since = 'mark': the step has no mark action",
        ),
        (
            HEAD + "    after: [zero]\n    expect: [{event: {name: drives_armed}}]\n",
            "steps.first.after = 'zero': no earlier step",
        ),
        (
            doing("call: {service: drives/arm, data: true}"),
            "steps.first.moves = False: should be true for a step that commands",
        ),
        (doing("call: {service: drives/arm}"), "call.data = null: missing"),
        (
            doing("publish: {topic: winch/command, joints: {winch_drum: {velocity: 9}, "
                  "winch_brake: {}, winch_limit: {effort: 1}}}"),
            "velocity is 9.0 m/s, it must lie in -0.5 .. 0.5 m/s (or set invalid: true)",
        ),
        (
            doing("publish: {topic: wheel_motor/torque_command, unstamped: true, "
                  "joints: {wheel_drive: {}}}"),
            "publish.invalid = False: should be true for a deliberately invalid message",
        ),
        (
            doing("impair: {impairments: [{kind: rain}]}"),
            "impair.impairments[0] = {'kind': 'rain'}:",
        ),
        (
            doing("set: {node: a, parameter: b, value: [1]}"),
            "set.value = [1]: should be a number, a text, true or false",
        ),
        (
            doing(f"set: {{node: a, parameter: b, value: {10**30}}}"),
            "should be a whole number of 64 bits",
        ),
        (
            doing("publish: {topic: flywheel/command, age: -1.0e+10, invalid: true, "
                  "joints: {flywheel: {}}}"),
            "publish.age = -10000000000.0: should be a number at least -1e+08",
        ),
        (
            doing("publish: {topic: flywheel/command, rate: 1.0e-8, duration: 1, "
                  "joints: {flywheel: {}}}"),
            "publish.rate = 1e-08: should be a number at least",
        ),
        (
            doing("publish: {topic: flywheel/command, "
                  f"joints: {{flywheel: {{effort: {10**400}}}}}}}"),
            "should be a smaller number",
        ),
        (
            HEAD + "    attempts: 0\n    expect: [{event: {name: drives_armed}}]\n",
            "steps.first.attempts = 0: should be a whole number at least 1",
        ),
    ],
)  # fmt: skip
def test_a_malformed_procedure_is_refused(tmp_path: Path, text: str, complaint: str):
    path = loaded(tmp_path, text)
    with pytest.raises(ShippedError) as caught:
        load_procedure(path)
    assert str(caught.value).startswith(path)
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_unknown_procedure_is_refused_with_the_known_ones(tmp_path: Path):
    with pytest.raises(ShippedError, match="one of faults, interface_check, restart, watchdogs"):
        load_procedure("interface_chekc")
    with pytest.raises(ShippedError, match="cannot be read"):
        load_procedure(str(tmp_path / "none.yaml"))


@pytest.mark.parametrize(
    "topic",
    [topics.WINCH_COMMAND, topics.WHEEL_COMMAND, topics.FLYWHEEL_COMMAND, topics.WINCH_REQUEST],
)
def test_beyond_limits_exceeds_one_limit_in_each_message_and_covers_all(topic: str):
    row = TOPICS[topic]
    sent = BeyondLimits(topic=topic).messages()
    ends = [
        (field.path, limit)
        for field in row.fields
        for limit in (field.minimum, field.maximum)
        if math.isfinite(limit)
    ]
    assert len(sent) == len(ends)
    for (path, limit), (named, joints) in zip(ends, sent, strict=True):
        wrong = [
            (field.path, value)
            for field in row.fields
            for name, joint in joints.items()
            for part, value in zip(joint._fields, joint, strict=True)
            if f"{name}.{part}" == field.path and not field.minimum <= value <= field.maximum
        ]
        assert [found for found, _ in wrong] == [path] == [named]
        assert abs(wrong[0][1] - limit) <= 0.011 * max(1.0, abs(limit))


def test_a_command_is_published_at_the_contract_s_rate_by_default():
    given = {"topic": topics.WHEEL_TORQUE_COMMAND, "joints": {"wheel_drive": {}}}
    assert read(Publish, given).period == pytest.approx(0.02)
    assert read(Publish, {**given, "rate": 5.0}).period == 0.2


def test_the_document_describes_every_key_of_a_procedure():
    text = DOCUMENT.read_text(encoding="utf-8")
    missing = [
        word for word in (*ACTIONS, *EXPECTATIONS, *InterfaceRule) if f"`{word}`" not in text
    ]
    assert not missing
