"""Procedures against a simulated machine: PASS, FAIL and NOT RUN, with their reasons."""

from __future__ import annotations

import math
from typing import Any

import pytest
from simulated_environment import Machine, SimulatedEnvironment

from msg_schemas import topics
from msg_schemas.configuration import read
from msg_schemas.events import BridgeEvent
from rover_hil.rehearsal.expectation_result import Result
from rover_hil.rehearsal.procedure import Procedure
from rover_hil.rehearsal.procedure_result import ProcedureStepResult
from rover_hil.rehearsal.procedure_runner import ProcedureRunner

HOLD: dict[str, Any] = {
    "topic": topics.WINCH_COMMAND,
    "duration": 1.5,
    "joints": {
        "winch_drum": {"effort": 16.0},
        "winch_brake": {"position": 1.0},
        "winch_limit": {"effort": 200.0},
    },
}
NEVER = BridgeEvent.MISMATCH.value  # never published by the simulated environment
BRAKE = {"topic": topics.WINCH_STATE, "field": "winch_brake.position"}
ARM = {"call": {"service": topics.DRIVES_ARM, "data": True}}
RATE = {
    "rule": "rate",
    "title": "the rate is kept",
    "do": [{"wait": {"duration": 2.0}}],
    "expect": [{"rate": {"topics": topics.WINCH_STATE, "minimum": 190.0, "maximum": 210.0}}],
}
WATCHDOG: dict[str, Any] = {
    "rule": "watchdog",
    "title": "a command timeout closes the brake",
    "moves": True,
    "do": [ARM, {"publish": HOLD}],
    "expect": [
        {"value": {**BRAKE, "minimum": 1.0}},
        {"value": {**BRAKE, "maximum": 0.0, "within": 0.6, "since": "end"}},
        {"event": {"name": BridgeEvent.COMMANDS_CEASED.value, "within": 0.6, "since": "end"}},
    ],
}
NOT_ARMED = {
    "rule": "refusal",
    "title": "a disarmed drive refuses",
    "moves": True,
    "do": [{"publish": {**HOLD, "duration": 0.0}}],
    "expect": [{"refusal": {"subject": topics.WINCH_COMMAND, "code": "not_armed"}}],
}


def run_steps(
    machine: Machine | None = None, *, confirmed: bool = True, **steps: dict[str, Any]
) -> tuple[dict[str, ProcedureStepResult], SimulatedEnvironment]:
    environment = SimulatedEnvironment(machine)
    procedure = read(Procedure, {"about": "a trial", "steps": steps})
    runner = ProcedureRunner(environment, confirmed=confirmed)
    outcomes, completed = runner.run(procedure)
    assert completed
    return {each.name: each for each in outcomes}, environment


def test_a_correct_machine_passes():
    found, _ = run_steps(rate=RATE, not_armed=NOT_ARMED, watchdog=WATCHDOG)
    assert {each.result for each in found.values()} == {Result.PASS}
    assert found["rate"].results[0].measured == "200 Hz"
    reaction = float(found["watchdog"].results[2].measured.split()[0])
    assert reaction == pytest.approx(0.5, abs=0.02)
    assert all(each.topics and each.end_ns >= each.begin_ns for each in found["watchdog"].results)


@pytest.mark.parametrize(
    ("machine", "step", "measured"),
    [
        (Machine(rate=100.0), RATE, "100 Hz"),
        (Machine(timeout=0.9), WATCHDOG, "not reached, 1 to 1"),
        (Machine(timeout=math.inf), WATCHDOG, "did not occur"),
        (Machine(refuses=False), NOT_ARMED, "did not occur"),
    ],
)
def test_a_broken_machine_fails_with_what_was_measured(
    machine: Machine, step: dict[str, Any], measured: str
):
    found, _ = run_steps(machine, step=step)
    assert found["step"].result is Result.FAIL
    failed = [each for each in found["step"].results if each.result is Result.FAIL]
    assert any(measured in each.measured for each in failed), failed


@pytest.mark.parametrize("step", [NOT_ARMED, WATCHDOG])
def test_a_failure_while_another_source_owns_the_topic_is_not_run(step: dict[str, Any]):
    found, _ = run_steps(Machine(owner="winch_node-7"), step=step)
    assert found["step"].result is Result.NOT_RUN
    assert "stop the other command source first: winch_node-7" in found["step"].reason


def test_the_refusal_of_a_second_command_source_can_be_expected():
    owned = {"refusal": {"subject": topics.WINCH_COMMAND, "code": "owned"}}
    found, _ = run_steps(Machine(owner="winch_node-7"), step={**NOT_ARMED, "expect": [owned]})
    assert found["step"].result is Result.PASS


def test_a_late_reaction_is_reported_with_its_time():
    found, _ = run_steps(Machine(timeout=0.9), step=WATCHDOG)
    assert any(each.measured.startswith("0.9") for each in found["step"].results)


def test_a_failure_during_a_stall_of_the_rehearsal_is_repeated():
    machine = Machine(stall_at=0.9, stall=0.7)
    found, _ = run_steps(machine, step={**WATCHDOG, "expect": [
        *WATCHDOG["expect"], {"value": {**BRAKE, "minimum": 1.0, "when": "always",
                                        "within": 1.2, "since": "mark"}}],
        "do": [ARM, {"publish": {**HOLD, "throughout": True, "duration": 0.0}},
               {"wait": {"duration": 0.2}}, {"mark": {}},
               {"wait": {"duration": 1.3}}]})  # fmt: skip
    assert found["step"].result is Result.PASS
    assert len(found["step"].invalid_attempts) == 1
    assert "published a command 0.69 s late" in found["step"].invalid_attempts[0]


@pytest.mark.parametrize(
    ("machine", "reason"),
    [
        (Machine(rate=50.0, real_time=False), "the emulated machine did not keep real time"),
        (Machine(rate=50.0, stall_at=0.5, stall=0.3, stall_count=99), "stalled for 0.3 s"),
        # A rate in range by a clock that stood still is invalid, too.
        (Machine(rate=200.0, real_time=False), "the emulated machine did not keep real time"),
    ],
)
def test_a_step_without_a_valid_attempt_is_not_run(machine: Machine, reason: str):
    found, _ = run_steps(machine, step=RATE)
    assert found["step"].result is Result.NOT_RUN
    assert found["step"].reason.startswith("3 invalid attempts, last: ")
    assert reason in found["step"].reason
    assert {each.result for each in found["step"].results} == {Result.NOT_RUN}


def test_a_real_machine_must_keep_its_times():
    found, _ = run_steps(Machine(rate=50.0, real_time=False, is_emulated=False), step=RATE)
    assert found["step"].result is Result.FAIL


def test_no_command_is_sent_before_motion_is_confirmed():
    found, environment = run_steps(
        confirmed=False, rate=RATE, not_armed=NOT_ARMED, watchdog=WATCHDOG
    )
    assert found["rate"].result is Result.PASS
    assert found["watchdog"].reason == found["not_armed"].reason == "motion was not confirmed"
    assert not environment.sent
    assert not environment.calls


@pytest.mark.parametrize(("answer", "result"), [(True, Result.PASS), (False, Result.NOT_RUN)])
def test_the_operator_confirms_motion(answer: bool, result: Result):
    machine = Machine(answers={"confirm_motion": answer})
    found, _ = run_steps(machine, confirmed=False, watchdog=WATCHDOG)
    assert found["watchdog"].result is result


@pytest.mark.parametrize("stops", [False, True])
def test_armed_drives_are_disarmed_at_the_end_also_after_a_stop(stops: bool):
    environment = SimulatedEnvironment()
    procedure = read(Procedure, {"about": "a trial", "steps": {"w": WATCHDOG, "r": RATE}})
    runner = ProcedureRunner(
        environment,
        confirmed=True,
        is_stopped=lambda: stops and environment.brake == 1.0,
    )
    outcomes, completed = runner.run(procedure)
    assert completed is not stops
    assert environment.calls[-1] == (topics.DRIVES_ARM, False)
    assert not environment.publishers
    if stops:
        assert [each.reason for each in outcomes] == [
            "the rehearsal was stopped before this step"
        ] * 2


def test_a_step_with_an_unmet_precondition_is_not_run_with_the_reason():
    common = {"rule": "rate", "title": "x", "expect": [{"event": {"name": NEVER}}]}
    impair = {"impair": {"impairments": [{"kind": "cut", "target": "winch"}]}}
    found, _ = run_steps(
        offers={**common, "needs": [topics.SIM_RESET_PLANT]},
        impairs={**common, "do": [impair]},
        calls={**common, "do": [{"call": {"service": topics.SIM_RESET_PLANT}}]},
        prompts={**common, "do": [{"prompt": {"key": "plug", "instruction": "Unplug it."}}]},
        commands={**NOT_ARMED, "do": [{"publish": {
            "topic": topics.WHEEL_COMMAND, "joints": {"wheel_drive": {"effort": 1.0}}}}]},
        follows={**RATE, "after": ["prompts"]},
    )  # fmt: skip
    assert {each.result for each in found.values()} == {Result.NOT_RUN}
    assert found["offers"].reason == f"{topics.SIM_RESET_PLANT} is not available"
    assert found["impairs"].reason == "drive_emulator/get_parameters has no server"
    assert found["calls"].reason == f"{topics.SIM_RESET_PLANT} has no server"
    assert found["prompts"].reason == "Unplug it. There is no operator at a terminal"
    assert found["commands"].reason == f"{topics.WHEEL_COMMAND} has no subscriber"
    assert found["follows"].reason == "step prompts has not passed"


def test_a_parameter_is_restored_after_the_step_unless_kept():
    step = {"rule": "rate", "title": "x", "expect": [{"event": {"name": NEVER, "absent": True}}]}
    impair = {"impair": {"impairments": [{"kind": "cut", "target": "winch", "duration": 2.0}]}}
    keep = {"set": {"node": "hil_bridge", "parameter": "kept", "value": 3, "keep": True}}
    parameters: dict[tuple[str, str], object] = {
        ("drive_emulator", "impairments"): "",
        ("hil_bridge", "kept"): 1,
    }
    found, environment = run_steps(
        Machine(parameters=parameters), step={**step, "do": [impair, keep]}
    )
    assert found["step"].result is Result.PASS
    assert [value for _, name, value in environment.set if name == "impairments"][1:] == [""]
    assert "cut" in str(environment.set[0][2])
    assert parameters["hil_bridge", "kept"] == 3


def test_the_step_after_an_impairment_waits_for_recovery():
    impair = {"impair": {"impairments": [{"kind": "cut", "target": "winch", "duration": 2.0}]}}
    impaired = {"rule": "rate", "title": "x", "do": [impair],
               "expect": [{"event": {"name": NEVER, "absent": True}}]}  # fmt: skip
    arms = {"rule": "safe_state", "title": "y", "moves": True, "do": [ARM]}
    machine = Machine(recovery=1.2, parameters={("drive_emulator", "impairments"): ""})
    found, _ = run_steps(machine, impaired=impaired, arms=arms)
    assert found["arms"].result is Result.PASS


def test_an_inspection_passes_by_the_operator_s_answer():
    step = {"rule": "safe_state", "title": "x",
            "do": [{"inspect": {"key": "still", "question": "Does the drum stand?"}}]}  # fmt: skip
    for answers, result in (
        ({"still": True}, Result.PASS),
        ({"still": False}, Result.FAIL),
        ({}, Result.NOT_RUN),
    ):
        found, _ = run_steps(Machine(answers=answers), step=step)
        assert found["step"].result is result


def test_every_value_beyond_a_limit_must_be_refused_also_by_a_node_that_holds_refusals_back():
    step = {"rule": "limits", "title": "x", "moves": True,
            "do": [{"beyond_limits": {"topic": topics.WINCH_COMMAND}}]}  # fmt: skip
    refused_before = {**NOT_ARMED, "do": [{"publish": {**HOLD, "duration": 0.0}}] * 7}
    found, _ = run_steps(before=refused_before, step=step)
    (result,) = found["step"].results
    assert result.result is Result.PASS
    assert result.measured == "18 of 18"
    found, _ = run_steps(Machine(refuses=False), step=step)
    assert found["step"].result is Result.FAIL


def test_a_value_is_read_from_the_machine_when_the_action_begins():
    amount = {
        "topic": topics.WINCH_STATE,
        "field": "winch_drum.position",
        "scale": 2.0,
        "offset": 1.0,
    }
    joints = {**HOLD["joints"], "winch_drum": {"effort": amount}}
    _, environment = run_steps(step={**NOT_ARMED, "do": [{"publish": {**HOLD, "duration": 0.0,
                                                                "joints": joints}}]})  # fmt: skip
    assert environment.sent[0][1].joints["winch_drum"].effort == 41.0


def test_invalid_messages_are_sent_as_specified():
    invalid = {**HOLD, "duration": 0.0, "invalid": True}
    _, environment = run_steps(step={**NOT_ARMED, "do": [
        {"publish": {**invalid, "unstamped": True}}, {"publish": {**invalid, "age": 0.8}},
        {"publish": {**invalid, "omit": "velocity"}}]})  # fmt: skip
    unstamped, old, short = (message for _, message in environment.sent)
    assert unstamped.stamp_ns == 0
    assert short.stamp_ns - old.stamp_ns == pytest.approx(0.8e9, abs=1e7)
    assert short.omit == "velocity"
