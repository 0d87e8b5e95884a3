"""A synthetic mission of a spatial rover with closed-form activities and metrics."""

import json
import math
from dataclasses import dataclass
from pathlib import Path

from contract_bag import MadeUp, ns

from msg_schemas import machine, topics
from msg_schemas.machine import PAYOUT as PAYOUT_JOINT
from msg_schemas.samples import (
    ClockSample,
    JointSample,
    JointValue,
    OdometrySample,
    TextSample,
    WrenchSample,
)

GRAVITY = 1.62
M1, M2 = 6.0, 4.0
WEIGHT = (M1 + M2) * GRAVITY
RADIUS = 0.15
RATE = 50.0
RIPPLE = 0.02  # of the tension, as amplitude over mean

SCENARIO = {
    "name": "made up",
    "model": "spatial",
    "environment": {"gravity": GRAVITY},
    "rover": {
        "m1": M1,
        "m2": M2,
        "inertia1": [0.078, 0.055, 0.115],
        "inertia2": [0.021, 0.021, 0.038],
        "wheels": {"radius": RADIUS},
        "jump_drive": {"inertia": 1e-3, "momentum_limit": 0.3},
        "wheel_drive": {"wheel_inertia": 6e-3},
    },
}


@dataclass(frozen=True)
class Leg:
    """One activity with its duration [s] and rate [m/s or rad/s]."""

    what: str
    duration: float
    rate: float = 0.0


MISSION = (
    Leg("hanging", 3.0),
    Leg("descending", 8.0, 0.25),
    Leg("hanging", 3.0),
    Leg("ascending", 4.0, -0.1),
    Leg("hanging", 2.0),
    Leg("descending", 5.0, 0.2),
    Leg("slack", 4.0, 0.3),
    Leg("standing", 2.0),
    Leg("driving", 4.0, 2.0),
    Leg("standing", 2.0),
    Leg("turning", 3.0, -2.0),
    Leg("standing", 2.0),
    Leg("compressing", 2.0, 0.06),
    Leg("flight", 1.2),
    Leg("standing", 3.0),
)
SHORT = (
    Leg("hanging", 2.0),
    Leg("descending", 4.0, 0.25),
    Leg("slack", 1.0, 0.3),
    Leg("standing", 1.0),
    Leg("driving", 2.0, 2.0),
    Leg("standing", 1.0),
    Leg("compressing", 1.0, 0.06),
    Leg("flight", 1.2),
    Leg("standing", 2.0),
)
SLIP = 0.1
_HOLDING, _DRIVING, _NOISE = 0.4, 0.3, 0.01  # currents of the wheel motor [A]
UP = 0.5 * GRAVITY * 1.2  # so that the flight is level
FORWARD = 0.3


def write_mission(
    path: Path,
    *,
    legs: tuple[Leg, ...] = MISSION,
    brake_at: float = math.inf,
    pitch: float = 0.0,
) -> Path:
    """Write the mission's bag; see `mission` for the other arguments."""
    return mission(legs=legs, brake_at=brake_at, pitch=pitch).write(path)


def mission(
    *, legs: tuple[Leg, ...] = MISSION, brake_at: float = math.inf, pitch: float = 0.0
) -> MadeUp:
    """Make the mission's messages.

    Args:
        legs: activities in their order.
        brake_at: time at which the winch faults and closes its brake [s].
        pitch: pitch of the rover throughout, nose up positive [rad].
    """
    made = MadeUp()
    made.add(0.0, topics.CONFIG, TextSample(json.dumps({"scenario": SCENARIO, "seed": 3})))
    length, x, z, angle, heading, nut = 10.0, 0.0, -10.3, [0.0, 0.0], 0.0, -0.03
    count = 0
    for leg in legs:
        for step in range(round(leg.duration * RATE)):
            time, since = count / RATE, step / RATE
            drum = leg.rate if leg.what in {"descending", "ascending", "slack"} else 0.0
            hangs = leg.what in {"hanging", "descending", "ascending"}
            wheels = [0.0, 0.0]
            vx, vz, spin = 0.0, 0.0, 0.0
            if hangs:
                vz = -drum
            if leg.what == "driving":
                wheels = [leg.rate, leg.rate]
                vx = (1.0 - SLIP) * RADIUS * leg.rate
            elif leg.what == "turning":
                wheels, spin = [leg.rate, 0.0], 0.5
            elif leg.what == "compressing":
                nut = max(nut, 0.0) + leg.rate / RATE
            elif leg.what == "flight":
                vx, vz = FORWARD, UP - GRAVITY * since
            force = 824.0 * nut if leg.what == "compressing" else 0.0
            # The brake closes shortly after the drum has come to rest.
            released = time < brake_at and (drum != 0.0 or since < 0.3 < time)
            _put(made, time, leg, length, drum, hangs, nut, force, released)
            # The body x axis stays forward: a turn shows in the angular rate only.
            pose = _pose(ns(time), (x, z), (heading, pitch), (vx, vz), spin)
            made.add(time, topics.TRUTH_BODY1, pose)
            above = (x, 0.0, z + 0.2)
            made.add(
                time, topics.TRUTH_BODY2,
                OdometrySample(ns(time), above, pose.orientation, pose.linear, pose.angular),
            )  # fmt: skip
            angle = [a + w / RATE for a, w in zip(angle, wheels, strict=True)]
            joints = {
                name: JointValue(a, w)
                for name, a, w in zip(
                    (machine.WHEEL_LEFT, machine.WHEEL_RIGHT), angle, wheels, strict=True
                )
            }
            made.add(time, topics.WHEEL_STATE, JointSample(ns(time), joints))
            # At rest the wheel motor holds the attitude, or the rover on its slope.
            current = _HOLDING + _NOISE * math.sin(40.0 * time)
            if leg.what in {"driving", "turning"}:
                current = math.copysign(_DRIVING, leg.rate)
            drawn = {name: JointValue() for name in (machine.JUMP_MOTOR, machine.WINCH_MOTOR)}
            drawn[machine.WHEEL_MOTOR] = JointValue(0.0, 0.0, current)
            made.add(time, topics.MOTOR_CURRENTS, JointSample(ns(time), drawn))
            length += drum / RATE
            heading += spin / RATE
            x += vx / RATE
            z += vz / RATE - (0.5 * GRAVITY / RATE**2 if leg.what == "flight" else 0.0)
            count += 1
    return made


def _pose(
    stamp: int,
    place: tuple[float, float],
    turned: tuple[float, float],
    velocity: tuple[float, float],
    spin: float,
) -> OdometrySample:
    """Odometry at x and z [m], turned by heading and pitch [rad], of a world velocity [m/s]."""
    (heading, pitch), (vx, vz) = turned, velocity
    forward, left = vx * math.cos(heading), -vx * math.sin(heading)
    yaw_s, yaw_c = math.sin(heading / 2), math.cos(heading / 2)
    up_s, up_c = math.sin(pitch / 2), math.cos(pitch / 2)
    s, c = math.sin(pitch), math.cos(pitch)
    return OdometrySample(
        stamp,
        (place[0], 0.0, place[1]),
        (yaw_s * up_s, -yaw_c * up_s, yaw_s * up_c, yaw_c * up_c),
        (c * forward + s * vz, left, c * vz - s * forward),
        (0.0, 0.0, spin),
    )


def _put(
    made: MadeUp, time: float, leg: Leg, length: float, drum: float, hangs: bool,
    nut: float, force: float, released: bool,
) -> None:  # fmt: skip
    stamp = ns(time)
    made.add(time, topics.CLOCK, ClockSample(stamp))
    state = {
        machine.WINCH_DRUM: JointValue(length, drum, 0.0),
        machine.WINCH_BRAKE: JointValue(float(released)),
    }
    made.add(time, topics.WINCH_STATE, JointSample(stamp, state))
    estimate = {
        PAYOUT_JOINT: JointValue(length, drum),
        machine.STRETCHED: JointValue(length, drum),
        machine.TENSION: JointValue(1.0, 0.0, WEIGHT),
        machine.TETHER_OUT: JointValue(0.05, 0.0, 0.08),
        machine.REFERENCE: JointValue(length + (0.002 if leg.what == "descending" else 0.0), drum),
    }
    made.add(time, topics.WINCH_ESTIMATE, JointSample(stamp, estimate))
    touch = JointValue(0.0 if hangs or leg.what == "flight" else 1.0)
    switches = dict.fromkeys(
        (machine.FLOOR_SWITCH, machine.WHEEL_LEFT, machine.WHEEL_RIGHT, machine.BODY_SWITCH), touch
    )
    made.add(time, topics.CONTACT, JointSample(stamp, switches))
    pull = WEIGHT * (1.0 + RIPPLE * math.sin(40.0 * time)) if hangs else 0.0
    made.add(time, topics.LOAD_CELL, WrenchSample(stamp, (0.0, 0.0, -pull)))
    made.add(time, topics.ROVER_LOAD_CELL, WrenchSample(stamp, (0.0, 0.0, pull)))
    screw = JointValue(nut, 0.0, max(force, 0.0))
    made.add(time, topics.JUMP_MOTOR_STATE, JointSample(stamp, {machine.JUMP_SCREW: screw}))
    made.add(
        time, topics.FLYWHEEL_STATE, JointSample(stamp, {machine.FLYWHEEL: JointValue(0.0, 150.0)})
    )
    seen = JointValue(3.0 if leg.what == "hanging" else 1000.0)
    smear = JointValue(0.4 if time < 5.0 else 0.7)
    if round(time * RATE) % 5 == 0:
        made.add(
            time,
            topics.CAMERA,
            JointSample(stamp, {machine.WALL_DISTANCE: seen, machine.SMEAR: smear}),
        )
    energies = {name: JointValue() for name in machine.ENERGY_NAMES}
    energies["input"] = JointValue(2.0 * time)
    energies["dissipated"] = JointValue(1.5 * time)
    energies["gravity"] = JointValue(0.5 * time + 1e-6 * time)
    energies["drift"] = JointValue(1e-6 * time)
    made.add(time, topics.TRUTH_ENERGY, JointSample(stamp, energies))
