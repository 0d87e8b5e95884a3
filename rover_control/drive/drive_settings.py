"""Parameters of the drive controller. Pure."""

from __future__ import annotations

from dataclasses import dataclass, field

from msg_schemas.parameters import parameter
from rover_control.drive.drive_attitude import ROLLOVER_TILT
from rover_control.drive.drive_follower import FollowerParameters
from rover_control.drive.drive_odometry import OdometryParameters
from rover_control.drive.drive_planner import PlannerParameters
from rover_control.drive.drive_tether import TetherParameters
from rover_control.drive.drive_watch import WatchParameters
from rover_control.drive.flight_balance import FlightBalanceParameters
from rover_control.drive.ratchet_kinematics import ChassisParameters


@dataclass(frozen=True)
class DriveParameters:
    """Motor, gravity and supervision of the sensors."""

    torque_per_ampere: float = parameter(
        0.96, "N m/A", "wheel torque per ampere of motor current, gear included", 1e-3, 1e3
    )
    drive_gravity: float = parameter(1.62, "m/s^2", "gravity where the rover drives", 0.01, 100.0)
    sensor_timeout: float = parameter(
        0.5, "s", "age of the last sample at which a sensor is stale", 0.02, 60.0
    )
    sensor_timeout_steps: int = parameter(
        25, "-", "consecutive control steps with a stale sensor before the rover stops", 1, 10000
    )
    rollover_tilt: float = parameter(
        ROLLOVER_TILT, "rad", "tilt above which the rover counts as rolled over", 0.1, 3.2
    )
    floor_contact_timeout: float = parameter(
        1.0, "s", "time without floor contact after which the rover stops", 0.0, 60.0
    )


@dataclass(frozen=True)
class DriveSettings:
    """All parameters of the drive controller."""

    drive: DriveParameters = field(default_factory=DriveParameters)
    chassis: ChassisParameters = field(default_factory=ChassisParameters)
    odometry: OdometryParameters = field(default_factory=OdometryParameters)
    planner: PlannerParameters = field(default_factory=PlannerParameters)
    follower: FollowerParameters = field(default_factory=FollowerParameters)
    watch: WatchParameters = field(default_factory=WatchParameters)
    tether: TetherParameters = field(default_factory=TetherParameters)
    balance: FlightBalanceParameters = field(default_factory=FlightBalanceParameters)
