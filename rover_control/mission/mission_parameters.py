"""Parameters of the mission supervisor."""

from __future__ import annotations

from dataclasses import dataclass, field

from msg_schemas.parameters import parameter
from rover_control.mission.locomotion import LocomotionParameters
from rover_control.mission.mission_legs import LegLimits


@dataclass(frozen=True)
class MissionParameters:
    """Trials, time limits and resumption."""

    max_trials: int = parameter(3, "-", "largest number of trials of a leg", 1, 100)
    retry_delay: float = parameter(
        45.0, "s", "pause before a hanging leg is tried again, to estimate the swing", 0.0, 600.0
    )
    node_timeout: float = parameter(
        2.0, "s", "age of the last message at which winch or drive counts as missing", 0.2, 60.0
    )
    max_rearms: int = parameter(
        3, "-", "times that the mission arms the winch in one leg before it holds", 0, 100
    )
    resume_window: float = parameter(
        60.0, "s", "downtime up to which a restarted mission resumes by itself", 0.0, 1e5
    )


@dataclass(frozen=True)
class MissionSettings:
    """All parameters of the mission supervisor."""

    mission: MissionParameters = field(default_factory=MissionParameters)
    limits: LegLimits = field(default_factory=LegLimits)
    locomotion: LocomotionParameters = field(default_factory=LocomotionParameters)
