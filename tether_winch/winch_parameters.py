"""Parameters of the winch."""

from __future__ import annotations

from dataclasses import dataclass, field

from tether_winch.drum_model import DrumModelParameters
from tether_winch.estimates import EstimateParameters
from tether_winch.fault_monitor import FaultParameters
from tether_winch.load_monitor import LoadParameters
from tether_winch.requests import RequestParameters
from tether_winch.servo import ServoParameters


@dataclass(frozen=True)
class WinchParameters:
    """All parameters of the winch."""

    servo: ServoParameters = field(default_factory=ServoParameters)
    requests: RequestParameters = field(default_factory=RequestParameters)
    faults: FaultParameters = field(default_factory=FaultParameters)
    load: LoadParameters = field(default_factory=LoadParameters)
    estimates: EstimateParameters = field(default_factory=EstimateParameters)
    drum: DrumModelParameters = field(default_factory=DrumModelParameters)
