"""Mission supervisor on cooperative nodes: order of the legs, failures, operators and restarts."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from mission_machine import FLOOR, PLAN, MissionMachine, finished, missed, results, start_mission

from msg_schemas import topics
from msg_schemas.events import MissionEvent
from msg_schemas.faults import Reason
from msg_schemas.phases import DescentPhase, DrivePhase, JumpPhase, MissionPhase, WinchMode
from msg_schemas.refusal import Refusal
from rover_control.mission.locomotion import LocomotionParameters
from rover_control.mission.mission_checkpoint import checkpoint_of, restore
from rover_control.mission.mission_legs import LegLimits, LegResult
from rover_control.mission.mission_parameters import MissionParameters
from rover_control.mission.mission_plan import Lift, Waypoint
from rover_control.mission.mission_route import LegKind
from rover_control.mission.mission_supervisor import Mission
from rover_control.mission.observed_state import Place


def test_a_mission_goes_from_the_stow_to_the_floor_and_back():
    machine = start_mission()
    assert finished(machine)
    assert machine.mission.phase is MissionPhase.STANDBY
    assert results(machine) == {LegResult.DONE}
    assert len(machine.mission.record) == len(machine.mission.route.legs)
    assert machine.length == pytest.approx(PLAN.stow)
    assert machine.descent == DescentPhase.RELEASED
    assert machine.mission.blackboard.pictures == 3
    assert topics.JUMP_REQUEST not in machine.requests
    assert machine.operator.go(machine.now_ns)  # and again


def test_a_stuck_rover_gets_slack_jumps_and_drives_on():
    machine = start_mission(MissionPhase.DRIVING)
    machine.stuck = 1
    assert finished(machine)
    assert results(machine) == {LegResult.DONE}
    assert machine.mission.blackboard.jumps == 1
    slack = len(machine.requests) - 1 - machine.requests[::-1].index(topics.JUMP_REQUEST)
    assert machine.requests[slack - 1] == topics.WINCH_REQUEST


def test_the_rover_jumps_at_a_waypoint_with_a_jump_height():
    plan = replace(PLAN, survey=(Waypoint(x=2.0, y=0.0, jump_height=0.2),))
    machine = MissionMachine(plan)
    machine.publish()
    machine.operator.go(machine.now_ns)
    machine.run()
    assert [done.leg for done in machine.mission.record][3:5] == [
        "waypoint 1 at (2, 0) m", "jump at waypoint 1",
    ]  # fmt: skip
    assert results(machine) == {LegResult.DONE}
    assert machine.mission.blackboard.jumps == 1
    assert machine.requests.index(topics.DRIVE_GOAL) < machine.requests.index(topics.JUMP_REQUEST)


def test_a_refused_jump_at_a_waypoint_is_skipped():
    plan = replace(PLAN, survey=(Waypoint(x=2.0, y=0.0, jump_height=0.2),))
    machine = MissionMachine(plan)
    machine.refuses[topics.JUMP_REQUEST] = "too steep"
    machine.publish()
    machine.operator.go(machine.now_ns)
    machine.run()
    missed = [done for done in machine.mission.record if done.result is not LegResult.DONE]
    assert [(done.leg, done.reason) for done in missed] == [("jump at waypoint 1", "too steep")]
    assert machine.mission.phase is MissionPhase.STANDBY
    assert machine.length == pytest.approx(PLAN.stow)


def test_a_hanging_leg_is_tried_again_after_a_pause():
    machine = start_mission()
    machine.refuses[topics.DESCENT_REQUEST] = "it swings too much"
    machine.run(10.0, until=MissionPhase.STANDBY)
    assert machine.mission.failed_trials == 1
    count = machine.requests.count(topics.DESCENT_REQUEST)
    machine.refuses.clear()
    machine.run(MissionParameters().retry_delay - 12.0, until=MissionPhase.STANDBY)
    assert machine.requests.count(topics.DESCENT_REQUEST) == count
    assert finished(machine)
    assert results(machine) == {LegResult.DONE}


def test_a_winch_missing_for_a_while_costs_one_trial_at_most():
    machine = start_mission(MissionPhase.DRIVING)
    machine.silent.add(topics.WINCH_ESTIMATE)
    machine.refuses[topics.DRIVE_GOAL] = "winch/estimate missing or stale"
    machine.drive = DrivePhase.FAILED
    machine.record(topics.DRIVE_GOAL, Reason.FAULT, "winch/estimate missing or stale")
    machine.run(20.0, until=MissionPhase.STANDBY)
    assert machine.mission.failed_trials == 1
    assert machine.mission.phase is MissionPhase.DRIVING
    machine.silent.clear()
    machine.refuses.clear()
    assert finished(machine)
    assert results(machine) == {LegResult.DONE}


def test_a_choice_is_reported_with_its_reason_and_its_risks():
    machine = start_mission(MissionPhase.DRIVING)
    machine.stuck = 1
    assert finished(machine)
    (choice,) = machine.choices
    assert choice.values["mode"] == "jump"
    assert choice.values["rule"] == "risk"
    assert choice.values["wheels_risk"] == pytest.approx(2.0 / 3.0)
    assert choice.values["jump_risk"] == pytest.approx(1.0 / 3.0)
    assert "landing upright 1.00" in choice.message


@pytest.mark.parametrize(
    ("upright", "advice"), [(0.5, ""), (1.0, "jump rejected: the tether tension would be too high")]
)
def test_a_rejected_jump_leads_to_a_detour(upright: float, advice: str):
    machine = start_mission(MissionPhase.DRIVING)
    machine.stuck, machine.upright, machine.rejection = 1, upright, advice
    assert finished(machine)
    assert results(machine) == {LegResult.DONE}
    assert machine.mission.blackboard.jumps == 0
    assert [choice.values["mode"] for choice in machine.choices] == ["wheels"]
    assert advice in machine.choices[0].message


@pytest.mark.parametrize("cannot_turn", [False, True])
def test_a_detour_is_straight_where_the_rover_cannot_turn(cannot_turn: bool):
    machine = start_mission(MissionPhase.DRIVING)
    machine.stuck, machine.upright, machine.cannot_turn = 1, 0.5, cannot_turn
    assert finished(machine)
    _, (x, y), *_ = machine.goals
    ahead = 0.6 if cannot_turn else 0.6 * math.cos(0.8)
    assert (x, y) == pytest.approx((ahead, math.sqrt(0.36 - ahead**2)), abs=1e-9)


def test_a_rover_that_cannot_turn_drives_on_before_it_jumps():
    machine = start_mission(MissionPhase.DRIVING)
    machine.stuck, machine.cannot_turn = 2, True  # it does not get away from there
    assert finished(machine)
    assert [choice.values["mode"] for choice in machine.choices] == ["wheels", "jump"]
    assert machine.choices[0].values["wheels_risk"] == pytest.approx(0.05)
    assert machine.mission.blackboard.jumps == 1


def test_the_wheel_risk_is_1_above_the_slope_limit():
    machine = start_mission(MissionPhase.DRIVING)
    # At this probability of toppling a jump is worse than wheels stuck once on level ground.
    machine.stuck, machine.slope, machine.upright = 1, 0.4, 0.7
    assert finished(machine)
    (choice,) = machine.choices
    assert choice.values["wheels_risk"] == 1.0
    assert choice.values["mode"] == "jump"


def test_the_slack_rule_requests_no_prediction():
    machine = start_mission(
        MissionPhase.DRIVING, locomotion=LocomotionParameters(locomotion_rule="slack")
    )
    machine.stuck = 1
    assert finished(machine)
    assert [choice.values["mode"] for choice in machine.choices] == ["wheels"]
    assert topics.JUMP_REQUEST not in machine.requests


def test_detours_are_followed_by_jumps_and_then_the_leg_fails():
    machine = start_mission(
        MissionPhase.DRIVING, locomotion=LocomotionParameters(locomotion_rule="slack")
    )
    machine.stuck = 5
    machine.run(200.0, until=MissionPhase.RETURNING)
    modes = [choice.values["mode"] for choice in machine.choices]
    assert modes[:4] == ["wheels", "wheels", "jump", "jump"]
    assert MissionEvent.TRIAL_FAILED in machine.events


def test_a_jump_that_ends_in_a_fault_ends_the_trial_and_is_cleared():
    machine = start_mission(MissionPhase.DRIVING)
    machine.stuck = 1
    machine.run(until=MissionPhase.JUMPING)
    while machine.jump != JumpPhase.FLIGHT:
        machine.tick()
    machine.tick()
    machine.jump = JumpPhase.FAULT  # as after toppling
    machine.record(topics.JUMP_REQUEST, Reason.FAULT, "toppled")
    machine.run(1.0, until=MissionPhase.STANDBY)
    assert machine.mission.failed_trials == 1
    assert finished(machine)
    assert topics.JUMP_ABORT in machine.requests
    assert machine.mission.blackboard.jumps == 0


def test_a_jump_without_take_off_is_not_counted():
    machine = start_mission(MissionPhase.DRIVING)
    machine.stuck, machine.jump_fails = 1, True
    machine.run(60.0, until=MissionPhase.RETURNING)
    assert machine.mission.blackboard.jumps == 0
    assert MissionEvent.TRIAL_FAILED in machine.events


# --- operators -----------------------------------------------------------------------------------


def test_a_held_mission_comes_to_rest_and_resumes_its_leg():
    machine = start_mission(MissionPhase.LOOKING)
    machine.run(1.0)
    assert machine.descent == DescentPhase.TRAVELLING
    machine.operator.hold(machine.now_ns)
    machine.run(5.0, until=MissionPhase.STANDBY)
    assert machine.descent == DescentPhase.HOLDING
    assert machine.mission.phase is MissionPhase.HOLDING
    with pytest.raises(Refusal, match=topics.MISSION_RESUME):
        machine.operator.go(machine.now_ns)
    depth = machine.length
    machine.run(5.0, until=MissionPhase.STANDBY)
    assert machine.length == depth
    machine.operator.resume(machine.now_ns)
    assert finished(machine)
    assert results(machine) == {LegResult.DONE}


def test_a_held_mission_does_not_interfere_with_an_operator():
    machine = start_mission(MissionPhase.DRIVING)
    machine.operator.hold(machine.now_ns)
    machine.run(5.0, until=MissionPhase.STANDBY)
    assert machine.drive == DrivePhase.RELEASED
    count = len(machine.requests)
    machine.drive = DrivePhase.STEERED
    machine.run(5.0, until=MissionPhase.STANDBY)
    assert machine.drive == DrivePhase.STEERED
    assert len(machine.requests) == count


def test_a_finished_stop_is_not_aborted_before_its_phase_arrives():
    machine = start_mission(MissionPhase.LOOKING)
    while machine.mission.phase is not MissionPhase.APPROACHING:
        machine.tick()
    machine.descent = DescentPhase.EXPOSING  # the last phase received
    machine.run(0.3, until=MissionPhase.STANDBY)
    machine.descent = DescentPhase.STANDBY
    assert finished(machine)
    assert topics.DESCENT_ABORT not in machine.requests

    machine = start_mission(MissionPhase.LOOKING)
    while machine.mission.phase is not MissionPhase.APPROACHING:
        machine.tick()
    machine.descent = DescentPhase.EXPOSING  # another command source has requested a stop
    assert finished(machine)
    assert topics.DESCENT_ABORT in machine.requests


@pytest.mark.parametrize("is_skipped", [False, True])
def test_there_is_no_jump_at_a_waypoint_that_was_not_reached(is_skipped: bool):
    plan = replace(PLAN, survey=(Waypoint(x=2.0, y=0.0, jump_height=0.2),))
    machine = start_mission(MissionPhase.DRIVING, plan)
    if is_skipped:
        assert "next is return" in machine.operator.skip(machine.now_ns)
    else:
        machine.refuses[topics.DRIVE_GOAL] = "(2, 0) m is out of reach"
        machine.run(until=MissionPhase.RETURNING)
        machine.refuses.clear()
    assert finished(machine)
    assert missed(machine) == ["waypoint 1 at (2, 0) m", "jump at waypoint 1"]
    assert topics.JUMP_REQUEST not in machine.requests


def test_legs_of_the_return_cannot_be_skipped():
    machine = start_mission(MissionPhase.DRIVING)
    assert "waypoint 2" in machine.operator.skip(machine.now_ns)
    machine.run(until=MissionPhase.LIFTING)
    with pytest.raises(Refusal, match="part of the return"):
        machine.operator.skip(machine.now_ns)
    assert finished(machine)


def test_a_skipped_landing_skips_all_legs_on_the_floor():
    machine = start_mission(MissionPhase.APPROACHING)
    machine.run(until=MissionPhase.LANDING)
    assert "ascend" in machine.operator.skip(machine.now_ns)
    assert finished(machine)
    assert topics.DRIVE_GOAL not in machine.requests


def test_the_return_cannot_be_skipped_far_from_the_plumb_line():
    machine = start_mission(MissionPhase.DRIVING)
    machine.run(until=MissionPhase.RETURNING)
    with pytest.raises(Refusal, match="swings"):
        machine.operator.skip(machine.now_ns)


@pytest.mark.parametrize(
    "phase", [MissionPhase.LOOKING, MissionPhase.LANDING, MissionPhase.DRIVING]
)
def test_an_aborted_mission_comes_to_rest_and_returns_on_command(phase: MissionPhase):
    machine = start_mission(phase)
    machine.operator.abort(machine.now_ns)
    machine.run(20.0, until=MissionPhase.STANDBY)
    assert machine.mission.phase is MissionPhase.ABORTED
    assert machine.winch == WinchMode.HOLD
    assert machine.drive == DrivePhase.RELEASED
    assert machine.descent in (DescentPhase.RELEASED, DescentPhase.STANDBY)
    machine.operator.go(machine.now_ns)
    assert finished(machine)
    assert machine.length == pytest.approx(PLAN.stow)


def test_commands_without_an_active_mission_are_refused():
    machine = MissionMachine()
    operator, now = machine.operator, machine.now_ns
    with pytest.raises(Refusal, match="missing or stale"):
        operator.go(now)
    for request in (operator.hold, operator.resume, operator.skip):
        with pytest.raises(Refusal):
            request(now)
    assert operator.abort(now) == "no mission is active"
    machine.publish()
    operator.go(now)
    with pytest.raises(Refusal, match="looking"):
        operator.go(now)
    with pytest.raises(Refusal, match="no leg is held"):
        operator.resume(now)


def test_a_restarted_winch_is_armed_but_a_stopped_one_is_not():
    machine = start_mission(MissionPhase.LANDING)
    machine.winch = WinchMode.DISARMED
    assert finished(machine)
    assert results(machine) == {LegResult.DONE}

    machine = start_mission(MissionPhase.LANDING)
    machine.winch = WinchMode.STOP
    machine.run()
    assert machine.mission.phase is MissionPhase.HOLDING
    assert "stopped" in machine.mission.reason
    assert machine.winch == WinchMode.STOP


def test_repeated_winch_faults_end_in_a_hold():
    machine = start_mission(MissionPhase.LANDING)
    for _ in range(3000):
        machine.winch = WinchMode.FAULT if machine.winch == WinchMode.LENGTH else machine.winch
        machine.tick()
    assert machine.mission.phase is MissionPhase.HOLDING
    assert machine.requests.count(topics.WINCH_REARM) == 1 + MissionParameters().max_rearms


def test_all_trials_of_a_leg_share_the_number_of_re_arms():
    machine = start_mission(MissionPhase.LANDING, limits=LegLimits(land_timeout=20.0))
    for tick in range(600):
        machine.length = 7.0  # no landing within its time limit
        if tick % 90 == 10:
            machine.winch = WinchMode.FAULT
        machine.tick()
    assert machine.mission.phase is MissionPhase.HOLDING
    assert "re-arms in this leg" in machine.mission.reason
    assert machine.requests.count(topics.WINCH_REARM) == 1 + MissionParameters().max_rearms


def test_another_command_source_that_holds_the_winch_holds_the_mission():
    machine = start_mission(MissionPhase.LANDING)
    machine.run(1.0)
    machine.winch = WinchMode.HOLD
    machine.record(topics.WINCH_REQUEST, Reason.REQUESTED, "hold requested")
    machine.run()
    assert machine.mission.phase is MissionPhase.HOLDING
    assert "another command source holds the winch" in machine.mission.reason


@pytest.mark.parametrize(
    "phase",
    [
        MissionPhase.LOOKING,
        MissionPhase.LANDING,
        MissionPhase.DRIVING,
        MissionPhase.JUMPING,
        MissionPhase.RETURNING,
        MissionPhase.ASCENDING,
    ],
)
def test_an_operator_who_holds_the_winch_holds_the_mission(phase: MissionPhase):
    plan = replace(PLAN, survey=(Waypoint(x=2.0, y=0.0, jump_height=0.2),))
    machine = start_mission(phase, plan)
    machine.run(0.5, until=MissionPhase.HOLDING)
    machine.hold_winch()
    machine.run()
    assert machine.mission.phase is MissionPhase.HOLDING
    assert "another command source holds the winch" in machine.mission.reason
    machine.operator.resume(machine.now_ns)
    assert finished(machine)


def test_a_hold_of_the_winch_by_the_mission_itself_does_not_interrupt_it():
    machine = start_mission(MissionPhase.LANDING)
    machine.run(1.0)
    machine.drive = DrivePhase.STEERED
    machine.run(0.2, until=MissionPhase.HOLDING)
    assert topics.WINCH_HOLD in machine.requests
    assert finished(machine)
    assert MissionEvent.INTERRUPTED not in machine.events


@pytest.mark.parametrize(
    ("topic", "reason", "what"),
    [
        (topics.JUMP_REQUEST, Reason.REQUESTED, "holds the jump motor"),
        (topics.WINCH_REQUEST, Reason.SUPERSEDED, "moves the winch"),
    ],
)
def test_a_jump_that_another_command_source_stops_holds_the_mission(
    topic: str, reason: Reason, what: str
):
    plan = replace(PLAN, survey=(Waypoint(x=2.0, y=0.0, jump_height=0.2),))
    machine = start_mission(MissionPhase.JUMPING, plan)
    machine.refuses[topic] = "not now"  # its record is replaced by the one below
    while machine.requests[-1] != topic:
        machine.tick()
    machine.mission.observed.take_events()
    machine.record(topic, reason, "stopped")
    machine.run()
    assert machine.mission.phase is MissionPhase.HOLDING
    assert machine.mission.reason == f"another command source {what}"


def test_a_landing_that_another_command_source_replaces_holds_the_mission():
    machine = start_mission(MissionPhase.LANDING)
    machine.run(1.0)
    machine.record(topics.WINCH_REQUEST, Reason.SUPERSEDED, "replaced by winch/request")
    machine.run()
    assert machine.mission.phase is MissionPhase.HOLDING
    assert machine.mission.reason == "another command source moves the winch"


def test_the_lift_waits_until_the_drive_has_stopped_the_winch():
    machine = start_mission(MissionPhase.RETURNING)
    machine.winch = WinchMode.TENSION
    machine.run(until=MissionPhase.LIFTING)
    machine.run(2.0, until=MissionPhase.HOLDING)
    assert machine.winch == WinchMode.TENSION
    machine.winch = WinchMode.HOLD
    assert finished(machine)


def test_a_landing_ends_by_the_record_of_its_request():
    machine = start_mission(MissionPhase.LANDING)
    machine.length, machine._on_floor = FLOOR - 4.0, True  # the alarm alone
    machine.run(3.0, until=MissionPhase.DRIVING)
    assert machine.mission.phase is MissionPhase.LANDING
    machine.record(topics.WINCH_REQUEST, Reason.COMPLETED, "at 10 m")
    machine.run(1.0, until=MissionPhase.STANDBY)
    assert machine.mission.failed_trials == 1


def test_a_rover_that_stands_already_has_landed():
    machine = start_mission(MissionPhase.LANDING)
    machine.refuses[topics.WINCH_REQUEST] = "touchdown at 9 m: the ground carries the rover"
    machine.length, machine._on_floor = FLOOR, True
    machine.run(10.0, until=MissionPhase.DRIVING)
    assert machine.mission.phase is MissionPhase.DRIVING


def test_a_winch_hold_before_the_leg_s_first_request_is_ignored():
    machine = start_mission(MissionPhase.APPROACHING)
    while machine.mission.phase is not MissionPhase.LANDING:
        machine.tick()
    # The descent controller holds the winch when it releases it.
    machine.record(topics.WINCH_REQUEST, Reason.REQUESTED, "hold requested")
    assert finished(machine)
    assert results(machine) == {LegResult.DONE}


def test_a_second_mission_takes_its_heading_from_its_own_descent():
    machine = start_mission()
    assert finished(machine)
    machine.place, machine._on_floor = (0.0, 0.0, 0.7), False
    machine.operator.go(machine.now_ns)
    machine.run(1.0, until=MissionPhase.STANDBY)
    machine.turned = 0.3
    machine.run(until=MissionPhase.DRIVING)
    place = machine.mission.observed.place
    assert place is not None
    assert place.heading == pytest.approx(0.3)


def test_a_timeout_gives_the_reason_and_a_mandatory_leg_holds():
    limits = LegLimits(land_timeout=20.0)
    machine = start_mission(MissionPhase.LANDING, limits=limits)
    machine.silent.add(topics.WINCH_ESTIMATE)
    machine.run(200.0)
    assert machine.mission.phase is MissionPhase.HOLDING
    assert "the winch estimate is missing or stale" in machine.mission.reason
    assert machine.events.count(MissionEvent.TRIAL_FAILED) == MissionParameters().max_trials
    machine.silent.clear()
    machine.publish()
    machine.operator.resume(machine.now_ns)
    assert finished(machine)


def test_a_compressed_spring_is_let_down_before_the_lift():
    machine = start_mission(MissionPhase.DRIVING)
    machine.run(until=MissionPhase.RETURNING)
    machine.nut = 0.1
    assert finished(machine)
    assert machine.nut == 0.0
    assert topics.JUMP_ABORT in machine.requests


def test_a_restarted_drive_node_gets_the_pose():
    machine = start_mission(MissionPhase.DRIVING)
    machine.run(until=MissionPhase.RETURNING)
    before = len(machine.requests)
    machine.place, machine.drive = (0.0, 0.0, 0.0), DrivePhase.RELEASED
    machine.knows_place = False
    machine.tick()
    machine.tick()
    assert topics.DRIVE_START in machine.requests[before:]
    assert machine.place[0] == pytest.approx(2.0, abs=0.5)
    assert finished(machine)
    assert machine.place[:2] == (0.0, 0.0)


def test_the_winch_alone_does_the_last_trial_of_a_short_ascent():
    machine = start_mission(MissionPhase.LIFTING)
    machine.refuses[topics.DESCENT_REQUEST] = "the swing is not known"
    assert finished(machine)
    assert "by the winch alone" in machine.mission.record[-2].reason
    assert machine.length == pytest.approx(PLAN.stow)

    deep = replace(PLAN, lift=Lift(winch_only_length=0.0))
    machine = MissionMachine(deep)
    machine.publish()
    machine.operator.go(machine.now_ns)
    machine.run(until=MissionPhase.LIFTING)
    machine.refuses[topics.DESCENT_REQUEST] = "the swing is not known"
    machine.run()
    assert machine.mission.phase is MissionPhase.HOLDING
    assert "the swing is not known" in machine.mission.reason


PHASES = [
    MissionPhase.LOOKING, MissionPhase.APPROACHING, MissionPhase.LANDING, MissionPhase.DRIVING,
    MissionPhase.RETURNING, MissionPhase.LIFTING, MissionPhase.ASCENDING,
]  # fmt: skip


@pytest.mark.parametrize("phase", PHASES)
def test_a_mission_restarted_soon_resumes_by_itself(phase: MissionPhase):
    machine = start_mission(phase)
    machine.restart_mission()
    assert machine.mission.is_active
    assert finished(machine)
    assert len(machine.mission.record) == len(machine.mission.route.legs)
    assert results(machine) == {LegResult.DONE}


def test_a_descent_interrupted_during_the_downtime_is_resumed():
    machine = start_mission(MissionPhase.LOOKING)
    machine.run(1.0)
    saved, machine.descent = checkpoint_of(machine.mission, machine.now_ns), DescentPhase.HOLDING
    machine.mission = Mission(PLAN)
    restore(machine.mission, saved, machine.now_ns)
    machine.mission.step(machine.now_ns)  # before any latched sample is received
    assert finished(machine)
    assert results(machine) == {LegResult.DONE}


def test_a_mission_restarted_late_waits_for_resume():
    machine = start_mission(MissionPhase.DRIVING)
    machine.restart_mission(after=3600.0)
    assert machine.mission.phase is MissionPhase.HOLDING
    machine.operator.resume(machine.now_ns)
    assert finished(machine)


def test_a_mission_killed_after_giving_slack_jumps_with_that_slack():
    plan = replace(PLAN, survey=(Waypoint(x=2.0, y=0.0, jump_height=0.2),))
    machine = start_mission(MissionPhase.JUMPING, plan)
    while not machine.slack:
        machine.tick()
    machine.restart_mission()
    killed = machine.now
    machine.run(until=MissionPhase.RETURNING)
    assert results(machine) == {LegResult.DONE}
    assert machine.requests.count(topics.JUMP_REQUEST) == 1
    assert machine.now - killed < 30.0


def test_a_jump_requested_before_the_jump_node_is_known_is_requested_again():
    plan = replace(PLAN, survey=(Waypoint(x=2.0, y=0.0, jump_height=0.2),))
    machine = start_mission(MissionPhase.JUMPING, plan)
    while not machine.slack:
        machine.tick()
    machine.jump = ""
    machine.restart_mission()
    while topics.JUMP_REQUEST not in machine.requests:
        machine.tick()
    requested = machine.now
    machine.tick()
    machine.jump = JumpPhase.STANDBY
    machine.run(until=MissionPhase.RETURNING)
    assert results(machine) == {LegResult.DONE}
    assert machine.requests.count(topics.JUMP_REQUEST) == 2
    assert machine.now - requested < 30.0


def test_a_checkpoint_of_another_plan_or_run_is_ignored():
    machine = start_mission(MissionPhase.DRIVING)
    saved = checkpoint_of(machine.mission, machine.now_ns)
    for name, value in (("plan", "other"), ("stamp_ns", 10**15)):
        fresh = MissionMachine()
        restore(fresh.mission, {**saved, name: value}, fresh.now_ns)
        assert fresh.mission.phase is MissionPhase.STANDBY
        assert [change.name for change in fresh.mission.take_changes()] == [
            MissionEvent.CHECKPOINT_DISCARDED
        ]


def test_a_standing_rover_begins_on_the_floor():
    machine = MissionMachine()
    machine._on_floor, machine.length = True, 9.0
    machine.publish()
    machine.operator.go(machine.now_ns)
    assert machine.mission.leg is not None
    assert machine.mission.leg.kind is LegKind.VISIT
    assert finished(machine)


def test_a_mission_that_begins_on_the_floor_starts_at_the_given_pose():
    machine = MissionMachine()
    machine._on_floor, machine.length = True, 9.0
    machine.place, machine.knows_place = (1.5, -0.5, 0.7), True
    machine.publish()
    machine.operator.go(machine.now_ns)
    assert machine.mission.observed.place == Place(1.5, -0.5, 0.7)
    assert finished(machine)


def test_every_leg_has_a_time_limit():
    limits = LegLimits()
    assert all(limits.of(kind) > 0.0 for kind in LegKind)
