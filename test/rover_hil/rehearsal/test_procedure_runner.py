"""A procedure against a made-up machine: what passes, what fails, what was not run, and why."""

from __future__ import annotations

import math
from typing import Any

import pytest
from made_up_stand import Machine, MadeUpStand

from msg_schemas import topics
from msg_schemas.configuration import read
from rover_hil.rehearsal.finding import Verdict
from rover_hil.rehearsal.outcome import StepOutcome
from rover_hil.rehearsal.procedure import Procedure
from rover_hil.rehearsal.procedure_runner import ProcedureRunner

HOLD: dict[str, Any] = {
    "topic": topics.WINCH_COMMAND,
    "time": 1.5,
    "joints": {
        "winch_drum": {"effort": 16.0},
        "winch_brake": {"position": 1.0},
        "winch_limit": {"effort": 200.0},
    },
}
BRAKE = {"topic": topics.WINCH_STATE, "field": "winch_brake.position"}
ARM = {"call": {"service": topics.DRIVES_ARM, "data": True}}
RATE = {
    "rule": "rate",
    "title": "it comes",
    "do": [{"wait": {"time": 2.0}}],
    "expect": [{"rate": {"topics": topics.WINCH_STATE, "minimum": 190.0, "maximum": 210.0}}],
}
WATCHDOG: dict[str, Any] = {
    "rule": "watchdog",
    "title": "silence brakes",
    "moves": True,
    "do": [ARM, {"publish": HOLD}],
    "expect": [
        {"value": {**BRAKE, "minimum": 1.0}},
        {"value": {**BRAKE, "maximum": 0.0, "within": 0.6, "counts_from": "end"}},
        {"event": {"name": "winch_commands_ceased", "within": 0.6, "counts_from": "end"}},
    ],
}
NOT_ARMED = {
    "rule": "refusal",
    "title": "disarmed it refuses",
    "moves": True,
    "do": [{"publish": {**HOLD, "time": 0.0}}],
    "expect": [{"refused": {"subject": topics.WINCH_COMMAND, "code": "not_armed"}}],
}


def conducted(
    machine: Machine | None = None, *, confirmed: bool = True, **steps: dict[str, Any]
) -> tuple[dict[str, StepOutcome], MadeUpStand]:
    stand = MadeUpStand(machine)
    procedure = read(Procedure, {"about": "a trial", "steps": steps})
    outcomes, completed = ProcedureRunner(stand, confirmed=confirmed).run(procedure)
    assert completed
    return {each.name: each for each in outcomes}, stand


def test_a_good_machine_passes():
    found, _ = conducted(rate=RATE, not_armed=NOT_ARMED, watchdog=WATCHDOG)
    assert {each.verdict for each in found.values()} == {Verdict.PASS}
    assert found["rate"].findings[0].measured == "200 Hz"
    reaction = float(found["watchdog"].findings[2].measured.split()[0])
    assert reaction == pytest.approx(0.5, abs=0.02)
    assert all(each.topics and each.end_ns >= each.begin_ns for each in found["watchdog"].findings)


@pytest.mark.parametrize(
    ("machine", "step", "measured"),
    [
        (Machine(rate=100.0), RATE, "100 Hz"),
        (Machine(timeout=0.9), WATCHDOG, "not reached, 1 to 1"),
        (Machine(timeout=math.inf), WATCHDOG, "it did not come"),
        (Machine(refuses=False), NOT_ARMED, "it did not come"),
    ],
)
def test_a_broken_machine_fails_with_what_was_measured(
    machine: Machine, step: dict[str, Any], measured: str
):
    found, _ = conducted(machine, step=step)
    assert found["step"].verdict is Verdict.FAIL
    failed = [each for each in found["step"].findings if each.verdict is Verdict.FAIL]
    assert any(measured in each.measured for each in failed), failed


@pytest.mark.parametrize("step", [NOT_ARMED, WATCHDOG])
def test_beside_another_commander_a_failure_is_none_of_the_machine_s(step: dict[str, Any]):
    found, _ = conducted(Machine(owner="winch_node-7"), step=step)
    assert found["step"].verdict is Verdict.NOT_RUN
    assert "another commander should be ended first: winch_node-7" in found["step"].reason


def test_that_another_commander_is_refused_can_be_what_is_wanted():
    owned = {"refused": {"subject": topics.WINCH_COMMAND, "code": "owned"}}
    found, _ = conducted(Machine(owner="winch_node-7"), step={**NOT_ARMED, "expect": [owned]})
    assert found["step"].verdict is Verdict.PASS


def test_a_late_reaction_is_told_with_its_time():
    found, _ = conducted(Machine(timeout=0.9), step=WATCHDOG)
    assert any(each.measured.startswith("0.9") for each in found["step"].findings)


def test_a_failure_while_the_rehearsal_was_held_up_is_tried_again():
    machine = Machine(hiccup_at=0.9, hiccup=0.7)
    found, _ = conducted(machine, step={**WATCHDOG, "expect": [
        *WATCHDOG["expect"], {"value": {**BRAKE, "minimum": 1.0, "when": "always",
                                        "within": 1.2, "counts_from": "mark"}}],
        "do": [ARM, {"publish": {**HOLD, "throughout": True, "time": 0.0}},
               {"wait": {"time": 0.2}}, {"mark": {}}, {"wait": {"time": 1.3}}]})  # fmt: skip
    assert found["step"].verdict is Verdict.PASS
    assert len(found["step"].disturbances) == 1
    assert "sent 0.69 s late" in found["step"].disturbances[0]


@pytest.mark.parametrize(
    ("machine", "reason"),
    [
        (Machine(rate=50.0, real_time=False), "the emulated machine did not keep real time"),
        (Machine(rate=50.0, hiccup_at=0.5, hiccup=0.3, hiccups=99), "held up for 0.3 s"),
        # Nor does a rate that is right by a clock that stood.
        (Machine(rate=200.0, real_time=False), "the emulated machine did not keep real time"),
    ],
)
def test_an_attempt_that_says_nothing_of_the_machine_is_at_last_not_run(
    machine: Machine, reason: str
):
    found, _ = conducted(machine, step=RATE)
    assert found["step"].verdict is Verdict.NOT_RUN
    assert found["step"].reason.startswith("disturbed 3 times, at last: ")
    assert reason in found["step"].reason
    assert {each.verdict for each in found["step"].findings} == {Verdict.NOT_RUN}


def test_a_real_machine_has_no_excuse_for_its_computer():
    found, _ = conducted(Machine(rate=50.0, real_time=False, is_emulated=False), step=RATE)
    assert found["step"].verdict is Verdict.FAIL


def test_nothing_is_sent_before_motion_is_confirmed():
    found, stand = conducted(confirmed=False, rate=RATE, not_armed=NOT_ARMED, watchdog=WATCHDOG)
    assert found["rate"].verdict is Verdict.PASS
    assert found["watchdog"].reason == found["not_armed"].reason == "motion was not confirmed"
    assert not stand.sent
    assert not stand.calls


@pytest.mark.parametrize(("answer", "verdict"), [(True, Verdict.PASS), (False, Verdict.NOT_RUN)])
def test_the_operator_confirms_motion(answer: bool, verdict: Verdict):
    machine = Machine(answers={"confirm_motion": answer})
    found, _ = conducted(machine, confirmed=False, watchdog=WATCHDOG)
    assert found["watchdog"].verdict is verdict


@pytest.mark.parametrize("operator_ends", [False, True])
def test_what_was_armed_is_disarmed_at_the_end_also_when_the_operator_ends_it(operator_ends: bool):
    stand = MadeUpStand()
    procedure = read(Procedure, {"about": "a trial", "steps": {"w": WATCHDOG, "r": RATE}})
    runner = ProcedureRunner(
        stand, confirmed=True, is_over=lambda: operator_ends and stand.brake == 1.0
    )
    outcomes, completed = runner.run(procedure)
    assert completed is not operator_ends
    assert stand.calls[-1] == (topics.DRIVES_ARM, False)
    assert not stand.sendings
    if operator_ends:
        assert [each.reason for each in outcomes] == ["the rehearsal ended before it"] * 2


def test_what_a_machine_cannot_do_is_not_run_with_the_reason():
    wanted = {"rule": "rate", "title": "x", "expect": [{"event": {"name": "x"}}]}
    impair = {"impair": {"these": [{"what": "cut", "on": "winch"}]}}
    found, _ = conducted(
        offers={**wanted, "needs": [topics.SIM_RESET_PLANT]},
        impairs={**wanted, "do": [impair]},
        calls={**wanted, "do": [{"call": {"service": topics.SIM_RESET_PLANT}}]},
        asks={**wanted, "do": [{"ask": {"key": "plug", "what": "Unplug it."}}]},
        commands={**NOT_ARMED, "do": [{"publish": {
            "topic": topics.WHEEL_COMMAND, "joints": {"wheel_drive": {"effort": 1.0}}}}]},
        follows={**RATE, "after": ["asks"]},
    )  # fmt: skip
    assert {each.verdict for each in found.values()} == {Verdict.NOT_RUN}
    assert found["offers"].reason == f"nobody offers {topics.SIM_RESET_PLANT}"
    assert found["impairs"].reason == "nobody serves drive_emulator/get_parameters"
    assert found["calls"].reason == f"nobody serves {topics.SIM_RESET_PLANT}"
    assert found["asks"].reason == "Unplug it. There is no operator at a terminal"
    assert found["commands"].reason == f"nobody listens to {topics.WHEEL_COMMAND}"
    assert found["follows"].reason == "step asks has not passed"


def test_what_a_step_has_set_is_put_back_unless_it_says_otherwise():
    step = {"rule": "rate", "title": "x", "expect": [{"event": {"name": "never", "absent": True}}]}
    impair = {"impair": {"these": [{"what": "cut", "on": "winch", "duration": 2.0}]}}
    keep = {"set": {"node": "hil_bridge", "parameter": "kept", "value": 3, "keep": True}}
    parameters: dict[tuple[str, str], object] = {
        ("drive_emulator", "impairments"): "",
        ("hil_bridge", "kept"): 1,
    }
    found, stand = conducted(Machine(parameters=parameters), step={**step, "do": [impair, keep]})
    assert found["step"].verdict is Verdict.PASS
    assert [value for _, name, value in stand.set if name == "impairments"][1:] == [""]
    assert "cut" in str(stand.set[0][2])
    assert parameters["hil_bridge", "kept"] == 3


def test_what_follows_an_impairment_meets_a_machine_that_has_recovered():
    impair = {"impair": {"these": [{"what": "cut", "on": "winch", "duration": 2.0}]}}
    suffers = {"rule": "rate", "title": "x", "do": [impair],
               "expect": [{"event": {"name": "never", "absent": True}}]}  # fmt: skip
    arms = {"rule": "safe_state", "title": "y", "moves": True, "do": [ARM]}
    machine = Machine(recovery=1.2, parameters={("drive_emulator", "impairments"): ""})
    found, _ = conducted(machine, suffers=suffers, arms=arms)
    assert found["arms"].verdict is Verdict.PASS


def test_the_operator_s_eyes_judge():
    step = {"rule": "safe_state", "title": "x",
            "do": [{"look": {"key": "still", "question": "Does the drum stand?"}}]}  # fmt: skip
    for answers, verdict in (
        ({"still": True}, Verdict.PASS),
        ({"still": False}, Verdict.FAIL),
        ({}, Verdict.NOT_RUN),
    ):
        found, _ = conducted(Machine(answers=answers), step=step)
        assert found["step"].verdict is verdict


def test_every_limit_must_be_refused_with_its_name():
    step = {"rule": "limits", "title": "x", "moves": True,
            "do": [{"beyond_limits": {"topic": topics.WINCH_COMMAND}}]}  # fmt: skip
    found, _ = conducted(step=step)
    (finding,) = found["step"].findings
    assert finding.verdict is Verdict.PASS
    assert finding.measured == "18 of 18"
    found, _ = conducted(Machine(refuses=False), step=step)
    assert found["step"].verdict is Verdict.FAIL


def test_a_value_is_read_from_the_machine_when_the_step_begins():
    amount = {
        "topic": topics.WINCH_STATE,
        "field": "winch_drum.position",
        "times": 2.0,
        "plus": 1.0,
    }
    joints = {**HOLD["joints"], "winch_drum": {"effort": amount}}
    _, stand = conducted(step={**NOT_ARMED, "do": [{"publish": {**HOLD, "time": 0.0,
                                                                "joints": joints}}]})  # fmt: skip
    assert stand.sent[0][1].joints["winch_drum"].effort == 41.0


def test_stamps_are_as_the_procedure_wants_them():
    forbidden = {**HOLD, "time": 0.0, "forbidden": True}
    _, stand = conducted(step={**NOT_ARMED, "do": [
        {"publish": {**forbidden, "unstamped": True}}, {"publish": {**forbidden, "age": 0.8}},
        {"publish": {**forbidden, "omit": "velocity"}}]})  # fmt: skip
    unstamped, old, short = (message for _, message in stand.sent)
    assert unstamped.stamp_ns == 0
    assert short.stamp_ns - old.stamp_ns == pytest.approx(0.8e9, abs=1e7)
    assert short.omit == "velocity"
