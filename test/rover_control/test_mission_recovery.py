"""Recoveries of an immobilized rover by the winch."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from mission_machine import FLOOR, PLAN, MissionMachine, finished, missed, start_mission

from msg_schemas import topics
from msg_schemas.events import MissionEvent
from msg_schemas.faults import Reason
from msg_schemas.phases import DescentPhase, DrivePhase, MissionPhase
from rover_control.mission.mission_interlocks import Condition
from rover_control.mission.mission_parameters import MissionSettings
from rover_control.mission.mission_plan import Lift, RecoveryPlan
from rover_control.mission.mission_route import LegKind
from rover_control.mission.observed_state import Place

LIFTS = MissionSettings().mission.max_trials
TRIALS = 15  # number of failures in three trials of a leg with two jumps and two detours each
CALMS = 120.0  # time limit of the damping [s]


def test_an_unreachable_waypoint_is_skipped_and_the_rover_returns():
    machine = start_mission(MissionPhase.DRIVING)
    machine.stuck = (PLAN.recovery.max_count + 1) * TRIALS  # before each recovery, and after them
    assert finished(machine)
    assert missed(machine) == ["waypoint 1 at (2, 0) m"]
    (reason,) = [one.reason for one in machine.mission.record if one.leg in missed(machine)]
    assert "wheels turn" in reason
    assert machine.events.count(MissionEvent.RECOVERY_STARTED) == PLAN.recovery.max_count


def test_a_stuck_rover_is_set_down_below_the_fairlead_and_tries_again():
    machine = start_mission(MissionPhase.DRIVING)
    machine.stuck = TRIALS
    assert finished(machine)
    assert missed(machine) == []
    done = [one.leg for one in machine.mission.record]
    begin = done.index("recovery 1: lift off")
    assert done[begin + 1 : begin + 6] == [
        "recovery 1: set down", "recovery 1: lift off again", "recovery 1: damp swing at 7 m",
        "recovery 1: land", "waypoint 1 at (2, 0) m",
    ]  # fmt: skip
    assert len(done) == len(machine.mission.route.legs)


def test_each_waypoint_has_recoveries_of_its_own():
    machine = start_mission(MissionPhase.DRIVING)
    machine.stuck = (PLAN.recovery.max_count + 2) * TRIALS  # once at the second waypoint
    assert finished(machine)
    assert missed(machine) == ["waypoint 1 at (2, 0) m"]
    assert machine.events.count(MissionEvent.RECOVERY_STARTED) == PLAN.recovery.max_count + 1


def test_a_rover_that_has_rolled_over_is_hauled_at_once():
    machine = start_mission(MissionPhase.DRIVING)
    machine.run(1.0)
    machine.slope, machine.stuck, machine.rejection = 1.8, TRIALS, "too steep"
    machine.run(5.0, until=MissionPhase.LIFTING)
    assert machine.mission.phase is MissionPhase.LIFTING
    machine.stuck = 0
    assert finished(machine)
    assert missed(machine) == []
    assert machine.mission.blackboard.jumps == 0


@pytest.mark.parametrize("phase", [MissionPhase.DRIVING, MissionPhase.RETURNING])
def test_a_rover_lifted_by_its_tether_is_set_down_again(phase: MissionPhase):
    machine = start_mission(phase)
    machine.run(1.0, until=MissionPhase.STANDBY)
    machine._on_floor, machine.length = False, machine.length - 0.1
    machine.drive = DrivePhase.STUCK
    machine.run(25.0, until=MissionPhase.LIFTING)
    assert machine.mission.phase is MissionPhase.LIFTING
    assert finished(machine)
    assert missed(machine) == []


def test_a_restarted_winch_gets_time_to_detect_touchdown():
    machine = start_mission(MissionPhase.DRIVING)
    machine.run(1.0, until=MissionPhase.STANDBY)
    length = machine.length
    machine._on_floor, machine.length = False, length - 0.1  # as a restarted winch reports at first
    machine.run(10.0, until=MissionPhase.LIFTING)
    machine._on_floor, machine.length = True, length
    assert finished(machine)
    assert MissionEvent.RECOVERY_STARTED not in machine.events


def test_a_failed_return_is_completed_by_the_winch():
    machine = start_mission(MissionPhase.RETURNING)
    machine.stuck = TRIALS
    assert finished(machine)
    assert missed(machine) == []
    names = [done.leg for done in machine.mission.record]
    back = names.index("return")
    assert "completed by the winch" in machine.mission.record[back].reason
    recovery = ["recovery 1: lift off", "recovery 1: set down"]
    assert names[back + 1 : back + 4] == [*recovery, "lift off"]
    assert MissionEvent.RECOVERY_STARTED not in machine.events


def test_without_a_planned_landing_a_hauled_rover_is_lifted_at_once():
    machine = start_mission(plan=replace(PLAN, landing=None, survey=()))
    machine.operator.abort(machine.now_ns)
    machine.run(20.0, until=MissionPhase.STANDBY)
    machine.length = FLOOR  # an operator has set it down
    machine.publish()
    machine.mission.observed.place = Place(1.5, 0.0, 0.0)
    machine.operator.go(machine.now_ns)
    machine.stuck = TRIALS
    assert finished(machine)
    assert missed(machine) == []
    names = [done.leg for done in machine.mission.record]
    assert names[names.index("return") + 1] == "lift off"


@pytest.mark.parametrize("recovery", [RecoveryPlan(max_count=0), RecoveryPlan(radius=1.0)])
def test_without_a_possible_recovery_a_failed_return_holds(recovery: RecoveryPlan):
    machine = MissionMachine(replace(PLAN, recovery=recovery))
    machine.publish()
    machine.operator.go(machine.now_ns)
    machine.run(until=MissionPhase.RETURNING)
    machine.stuck = TRIALS
    machine.run()
    assert machine.mission.phase is MissionPhase.HOLDING
    assert "return" in machine.mission.reason


def test_a_refused_goal_starts_no_recovery():
    machine = start_mission(MissionPhase.DRIVING)
    machine.run(0.3)
    machine.refuses[topics.DRIVE_GOAL] = "the tether does not reach"
    machine.drive = DrivePhase.FAILED
    machine.record(topics.DRIVE_GOAL, Reason.FAULT, "let go")
    machine.run(60.0, until=MissionPhase.RETURNING)
    machine.refuses.clear()
    assert finished(machine)
    assert MissionEvent.RECOVERY_STARTED not in machine.events


@pytest.mark.parametrize(
    "leg",
    [
        "recovery 1: lift off",
        "recovery 1: set down",
        "recovery 1: lift off again",
        "recovery 1: damp swing at 7 m",
        "recovery 1: land",
    ],
)
def test_a_mission_restarted_in_a_recovery_resumes_it(leg: str):
    machine = start_mission(MissionPhase.DRIVING)
    machine.stuck = TRIALS
    while machine.mission.leg is not None and machine.mission.leg.name != leg:
        machine.tick()
    machine.run(0.5)
    machine.restart_mission()
    assert finished(machine)
    assert missed(machine) == []
    assert len(machine.mission.record) == len(machine.mission.route.legs)


def test_a_tumbling_rover_is_tracked_but_a_reset_odometry_is_not():
    machine = start_mission(MissionPhase.RETURNING)
    observed = machine.mission.observed
    x, y, heading = machine.place
    machine.place = (x - 0.5, y, heading + 2.0)
    machine.publish()
    assert observed.place is not None
    assert observed.place.heading == pytest.approx(heading + 2.0)
    machine.place, machine.knows_place = (0.0, 0.0, 0.0), False
    machine.publish()
    assert observed.place.heading == pytest.approx(heading + 2.0)


def test_a_rover_set_down_keeps_the_heading_of_the_odometry():
    machine = start_mission(MissionPhase.DRIVING)
    machine.stuck = TRIALS
    while machine.mission.leg is not None and machine.mission.leg.name != "recovery 1: land":
        machine.tick()
        hangs = machine.mission.phase in (MissionPhase.LIFTING, MissionPhase.APPROACHING)
        if hangs and machine.place[2] < 2.0:
            x, y, heading = machine.place
            machine.place = (x, y, heading + 0.05)
    x, y, turned = machine.place
    assert turned > 1.0
    machine.place = (x + 0.2, y, turned)  # where the odometry takes the rover to be
    machine.run(until=MissionPhase.DRIVING)
    machine.tick()
    assert machine.place == pytest.approx((0.0, 0.0, turned))  # the start pose of drive_node


def test_an_odometry_that_has_drifted_off_moves_the_place():
    before, after = Place(1.0, 2.0, 0.5), Place(1.1, 2.0, 0.6)
    moved = Place(0.0, 0.0, 0.5 + 0.5 * math.pi).moved(before, after)
    assert (moved.x, moved.y) == pytest.approx((0.0, 0.1))
    assert moved.heading == pytest.approx(0.6 + 0.5 * math.pi)


def test_far_from_the_plumb_line_the_rover_is_hauled_slowly_despite_snags():
    plan = replace(PLAN, lift=Lift(rate=0.1), recovery=RecoveryPlan(rate=0.03))
    machine = start_mission(MissionPhase.RETURNING, plan)
    machine.stuck = TRIALS
    machine.run(until=MissionPhase.LIFTING)
    machine.run(1.0, until=MissionPhase.STANDBY)
    assert machine.rate == 0.03
    failed = machine.events.count(MissionEvent.TRIAL_FAILED)
    machine.record(topics.WINCH_REQUEST, Reason.SNAG, "9 N")
    assert finished(machine)
    assert missed(machine) == []
    assert machine.events.count(MissionEvent.TRIAL_FAILED) == failed


def test_below_the_fairlead_a_snag_fails_the_lift():
    machine = start_mission(MissionPhase.LIFTING, replace(PLAN, lift=Lift(rate=0.1)))
    machine.run(1.0, until=MissionPhase.STANDBY)
    assert machine.rate == 0.1
    machine.record(topics.WINCH_REQUEST, Reason.SNAG, "9 N")
    machine.run(1.0, until=MissionPhase.STANDBY)
    assert machine.mission.failed_trials == 1
    assert finished(machine)


def test_damping_ends_at_its_time_limit_whatever_the_swing():
    machine = start_mission(MissionPhase.DRIVING)
    machine.stuck = TRIALS
    while machine.mission.leg is not None and machine.mission.leg.kind is not LegKind.DAMP:
        machine.tick()
    machine.swings, begin = True, machine.now
    machine.run(0.5 * CALMS, until=MissionPhase.LANDING)
    machine.length += 1.0  # a stroke of the winch, for some ticks
    machine.run(2.0 * CALMS, until=MissionPhase.LANDING)
    assert machine.now - begin == pytest.approx(CALMS, abs=10.0)
    assert "swinging by 1.15 x 0.29 deg" in machine.mission.record[-1].reason
    machine.swings = False
    assert finished(machine)
    assert missed(machine) == []


@pytest.mark.parametrize("reason", [Reason.COMPLETED, Reason.TOUCHDOWN])
def test_a_lift_from_a_slack_tether_reels_in_until_the_rover_hangs(reason: Reason):
    machine = MissionMachine()
    machine.length = FLOOR + 1.0  # the tether is slack
    machine.reached_on_floor = reason
    machine.publish()
    machine.operator.go(machine.now_ns)
    machine.run(until=MissionPhase.LIFTING)
    assert machine.length > FLOOR + PLAN.lift.height
    machine.run(until=MissionPhase.ASCENDING)
    assert machine.length == pytest.approx(FLOOR - PLAN.lift.height, abs=0.11)
    assert finished(machine)
    assert missed(machine) == []
    assert MissionEvent.TRIAL_FAILED not in machine.events


def test_a_rover_on_higher_ground_is_lifted_from_there():
    machine = start_mission(MissionPhase.RETURNING)
    machine.floor = machine.length = FLOOR - 2.0
    machine.refuses_payout = True
    assert finished(machine)
    assert missed(machine) == []


def test_a_lift_fails_if_the_rover_still_stands_near_the_stow():
    machine = start_mission(MissionPhase.LIFTING)
    machine.floor = PLAN.stow
    machine.run()
    assert machine.mission.phase is MissionPhase.HOLDING
    assert "still stands at" in machine.mission.reason
    assert PLAN.stow <= machine.length < PLAN.stow + PLAN.lift.height


@pytest.mark.parametrize("times", [1, LIFTS - 1])
def test_a_rover_that_comes_down_at_the_start_of_the_ascent_is_lifted_again(times: int):
    machine = start_mission(MissionPhase.LIFTING)
    for _ in range(times):
        machine.run(until=MissionPhase.ASCENDING)
        come_down(machine)
        machine.run(60.0, until=MissionPhase.LIFTING)
        assert machine.mission.phase is MissionPhase.LIFTING
    assert finished(machine)
    assert missed(machine) == []
    assert machine.events.count(MissionEvent.TRIAL_FAILED) == times


def test_a_rover_that_always_comes_down_is_not_lifted_for_ever():
    machine = start_mission(MissionPhase.LIFTING)
    for _ in range(LIFTS):
        machine.run(until=MissionPhase.ASCENDING)
        come_down(machine)
        machine.run(60.0, until=MissionPhase.LIFTING)
    assert machine.mission.phase is MissionPhase.ASCENDING
    assert machine.mission.waiting_on == Condition.STANDING.value


def come_down(machine: MissionMachine) -> None:
    """Interrupt the descent controller with the rover back on the floor."""
    machine.tick()
    machine.length, machine.descent = machine.floor, DescentPhase.HOLDING
    machine.record(topics.DESCENT_REQUEST, Reason.TOUCHDOWN, "the rover stands")
