"""Convert a spatial scenario and commands to the inputs of the compiled functions."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from rover_sim.physics.ground.rover_contact import RoverContact
from rover_sim.physics.ground.tether_contact import TetherContactParameters
from rover_sim.physics.ground.wheel_soil import wheel_on_soil
from rover_sim.physics.ground.wheel_table import wheel_table
from rover_sim.physics.integrators.drive_states import DriveCommands
from rover_sim.physics.integrators.session import Model
from rover_sim.physics.mechanisms import drum as drums
from rover_sim.physics.mechanisms import jump_drive, slider, wheel_drive
from rover_sim.physics.mechanisms.motor import MotorMode
from rover_sim.physics.mechanisms.prescribed_rotors import (
    PrescribedRotors,
    make_rotors,
    rotor_momentum,
)
from rover_sim.physics.rover import spatial_rover as bodies
from rover_sim.physics.tether.driven_end import NOT_DRIVEN, DrivenEnd, make_driven_end
from rover_sim.physics.tether.point_masses import PointMasses
from rover_sim.physics.tether.tether import make_tether
from rover_sim.plants.plant import (
    FlywheelCommand,
    FlywheelRateCommand,
    JumpMotorCommand,
    PlantCommand,
    WheelRateCommand,
    WheelTorqueCommand,
    WinchCommand,
)
from rover_sim.scenarios.hardware import RoverSettings
from rover_sim.scenarios.spatial_scenario import DrivenEndSettings, SpatialScenario

_OFF = int(MotorMode.OFF)
# The nut must press the latch through to trip it: its setpoint is beyond the commanded one [m].
_BEYOND_TRIP = 2.0e-3
_AT_ONCE = 1.0e-6
"""Relaxation time of a settling tether [s]."""
_NO_JUMP = jump_drive.JumpCommand(_OFF, 0.0, 0.0, 0.0, math.inf, math.inf)
_NO_WINCH = drums.DrumCommand(_OFF, 0.0, 0.0, math.inf, False)
_NO_WHEELS = wheel_drive.WheelCommand(_OFF, 0.0, 0.0, math.inf)
# Studies and identifications build many plants with equal wheels and soil.
_known_table = lru_cache(maxsize=16)(wheel_table)


def make_model(scenario: SpatialScenario) -> Model:
    """Return the constants of a run."""
    tether, environment, integration = scenario.tether, scenario.environment, scenario.integration
    rover = scenario.rover if scenario.rover is not None else RoverSettings()
    if scenario.winch is None:
        drum = drums.make_drum(drums.DrumParameters(), max(tether.whole_length, 1.0))
    else:
        drum = drums.make_drum(scenario.winch, tether.whole_length)
    law = (tether.contact or TetherContactParameters()).law()
    if tether.contact is None:
        law = law._replace(
            rock=law.rock._replace(stiffness=0.0), regolith=law.regolith._replace(stiffness=0.0)
        )
    chain, _ = scenario.chain
    nominal = tether.nominal_length
    return Model(
        tether=make_tether(
            tether.section,
            chain * nominal,
            chain,
            (0.0, 0.0, -scenario.gravity),
            integration.numerical_damping,
        ),
        has_winch=scenario.winch is not None,
        root_motion=_driven(scenario.root),
        tip_motion=_driven(None if scenario.tip is None else scenario.tip.motion),
        drum=drum,
        has_rover=scenario.rover is not None,
        tip_mass=0.0 if scenario.tip is None else float(scenario.tip.mass),
        rover=bodies.SpatialRover(
            float(rover.m1),
            float(rover.m2),
            rover.inertia,
            rover.attachment,
            tuple(rover.body2_place(0.0).tolist()),
        ),
        slider=slider.make_slider(rover.slider),
        jump=_jump_drive(rover),
        wheels=wheel_drive.make_wheel_drive(rover.wheel_drive),
        rotors=_rotors(rover),
        rover_contact=_rover_contact(scenario, rover),
        has_ground=environment.floor is not None,
        terrain=environment.build(),
        tether_contact=law,
        drag=environment.drag(),
        masses=_point_masses(scenario),
        torsion=float(tether.twist_stiffness),
        curvature=tether.curvature_from_tip(scenario.most_elements + 2),
        relaxation=tether.relaxation,
        swivel_torque=float(tether.swivel_friction),
        breaking_load=float(tether.section.breaking_load),
        step=float(integration.h),
        tolerance=float(integration.tolerance),
        max_halvings=int(integration.max_halvings),
    )


def _jump_drive(rover: RoverSettings) -> jump_drive.JumpDrive:
    drive = jump_drive.make_jump_drive(rover.jump_drive)
    if rover.is_single_body:
        # There is no latch to engage: the nut stops short of its place.
        short = min(drive.clearance, 0.5 * drive.free_travel)
        drive = drive._replace(stroke=0.0, over_travel=-short)
    return drive


def _driven(motion: DrivenEndSettings | None) -> DrivenEnd:
    if motion is None:
        return NOT_DRIVEN
    table = np.array(motion.rows)
    return make_driven_end(table[:, 0], table[:, 1:] - table[0, 1:])


def _point_masses(scenario: SpatialScenario) -> PointMasses:
    masses, nominal = scenario.tether.masses, scenario.tether.nominal_length
    places = np.array([each.position for each in masses]) / nominal
    element = np.minimum(places.astype(np.int64), scenario.chain[0] - 1)
    return PointMasses(element, places - element, np.array([float(each.mass) for each in masses]))


def _rotors(rover: RoverSettings) -> PrescribedRotors:
    axes = np.array([each.unit_axis for each in rover.rotors]).reshape(-1, 3)
    tables = [np.array(each.rows or ((0.0, each.momentum),)) for each in rover.rotors]
    return make_rotors(axes, [table[:, 0] for table in tables], [table[:, 1] for table in tables])


def at_start(model: Model) -> Model:
    """Return the model with driven ends and prescribed rotors as at the start."""
    momentum = rotor_momentum.py_func(model.rotors, 0.0)
    return model._replace(
        rotors=PrescribedRotors(np.zeros(1), np.array([momentum])),
        root_motion=NOT_DRIVEN,
        tip_motion=NOT_DRIVEN._replace(active=model.tip_motion.active),
    )


def _rover_contact(scenario: SpatialScenario, rover: RoverSettings) -> RoverContact:
    environment, wheels = scenario.environment, rover.wheels
    corners, first = rover.corners
    table = _known_table(wheel_on_soil(wheels, environment.soil))
    centres = np.linalg.norm([wheels.left, wheels.right], axis=1)
    return RoverContact(
        corners=np.ascontiguousarray(corners),
        first_body2_corner=first,
        left_wheel=wheels.left,
        right_wheel=wheels.right,
        radius=float(wheels.radius),
        tip_radius=float(wheels.tip_radius),
        reach=float(np.max([*np.linalg.norm(corners, axis=1), *(centres + wheels.tip_radius)])),
        regolith=environment.regolith.law(),
        rock=environment.rock.law(),
        wheel=environment.wheel_law(table),
    )


def damped(model: Model, axial: float, bending: float) -> Model:
    """Return the model with at least these damping times of the tether [s], at once relaxed."""
    tether = model.tether
    return model._replace(
        relaxation=model.relaxation._replace(time=_AT_ONCE),
        tether=tether._replace(
            axial_damping_time=max(axial, tether.axial_damping_time),
            bending_damping_time=max(bending, tether.bending_damping_time),
        ),
    )


def make_orders(
    scenario: SpatialScenario,
    model: Model,
    command: PlantCommand,
    *,
    free: bool,
    drum_radius: float | None = None,
) -> DriveCommands:
    """Convert a command to the drives' commands of a tick.

    The flywheel's drive is interlocked with the latch: it is off unless the nut is `free`.
    `drum_radius` is the radius of the tether's layer on the drum [m]; None: the innermost layer.

    Raises:
        ValueError: the scenario lacks the commanded motor, or a value is not finite or out of
            range.
    """
    if scenario.rover is None:
        for name in ("jump", "wheel"):
            if getattr(command, name) is not None:
                raise ValueError(f"{name}: the scenario has no rover; must be None")
    elif (
        scenario.rover.is_single_body
        and isinstance(command.jump, JumpMotorCommand)
        and command.jump.compression > 0.0
    ):
        raise ValueError(
            f"compression = {command.jump.compression}: must be at most 0, the rover has a single"
            " body (rover.m2 = 0) and cannot jump"
        )
    if scenario.winch is None and command.winch is not None:
        raise ValueError("winch: the scenario has no winch; must be None")
    return DriveCommands(
        jump=_jump_order(model, command.jump, free=free),
        drum=_NO_WINCH
        if command.winch is None
        else _drum_order(model, command.winch, drum_radius or model.drum.radius),
        wheels=_wheel_order(model, command.wheel),
    )


def _jump_order(
    model: Model,
    command: JumpMotorCommand | FlywheelCommand | FlywheelRateCommand | None,
    *,
    free: bool,
) -> jump_drive.JumpCommand:
    if command is None:
        return _NO_JUMP
    if isinstance(command, FlywheelCommand):
        torque = _finite("torque", command.torque, "N m")
        if not free:
            return _NO_JUMP
        return _NO_JUMP._replace(mode=int(MotorMode.TORQUE), torque=torque)
    drive = model.jump
    if isinstance(command, FlywheelRateCommand):
        rate = _finite("rate", command.rate, "rad/s") * drive.pitch
        return _NO_JUMP._replace(mode=int(MotorMode.RATE), rate=rate) if free else _NO_JUMP
    compression = _finite("compression", command.compression, "m")
    if not -drive.free_travel <= compression <= drive.stroke:
        raise ValueError(
            f"compression = {compression}: must lie between {-drive.free_travel:g}, the top of the"
            f" nut's free travel, and the stroke of {drive.stroke:g} m"
        )
    trips = compression > 0.0 and command.trips
    return jump_drive.JumpCommand(
        int(MotorMode.POSITION),
        0.0,
        compression + (_BEYOND_TRIP if trips else 0.0),
        _positive("rate", command.rate, "m/s"),
        _limit("max_force", command.max_force, "N"),
        compression if trips else math.inf,
    )


def _drum_order(model: Model, command: WinchCommand, radius: float) -> drums.DrumCommand:
    drum = model.drum
    if not (math.isfinite(command.length) and command.length >= 0.0):
        raise ValueError(f"length = {command.length}: must be finite and not below 0 m")
    feed_forward = _finite("feed_forward", command.feed_forward, "N")
    if feed_forward < 0.0:
        raise ValueError(f"feed_forward = {feed_forward}: must not be below 0 N")
    largest = _limit("max_tension", command.max_tension, "N")
    per_newton = radius / drum.gear_ratio
    return drums.DrumCommand(
        int(MotorMode.RATE),
        -feed_forward * per_newton,
        _finite("rate", command.rate, "m/s"),
        largest * per_newton / drum.efficiency,
        bool(command.brake_released),
    )


def _wheel_order(
    model: Model, command: WheelRateCommand | WheelTorqueCommand | None
) -> wheel_drive.WheelCommand:
    drive = model.wheels
    at_motor = 1.0 / (drive.gear_ratio * drive.efficiency)
    if command is None:
        return _NO_WHEELS
    if isinstance(command, WheelTorqueCommand):
        torque = _finite("torque", command.torque, "N m")
        return _NO_WHEELS._replace(mode=int(MotorMode.TORQUE), torque=torque * at_motor)
    largest = _limit("max_torque", command.max_torque, "N m")
    rate = _finite("rate", command.rate, "rad/s")
    return wheel_drive.WheelCommand(int(MotorMode.RATE), 0.0, rate, largest * at_motor)


def check_tick(dt: float) -> float:
    """Return the tick [s].

    Raises:
        ValueError: it is not finite or not above 0.
    """
    return _positive("dt", dt, "s")


def _finite(name: str, value: float, unit: str) -> float:
    if not math.isfinite(value):
        raise ValueError(f"{name} = {value}: must be finite [{unit}]")
    return float(value)


def _positive(name: str, value: float, unit: str) -> float:
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"{name} = {value}: must be finite and above 0 {unit}")
    return float(value)


def _limit(name: str, value: float, unit: str) -> float:
    if not value > 0.0:
        raise ValueError(f"{name} = {value}: must be above 0 {unit}")
    return float(value)
