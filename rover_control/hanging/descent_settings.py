"""All parameters of a descent. Pure."""

from __future__ import annotations

from dataclasses import dataclass, field

from rover_control.coordination.winch_link import WinchLinkParameters
from rover_control.hanging.descent_parameters import DescentParameters
from rover_control.hanging.hanging_controller import HangingControllerParameters


@dataclass(frozen=True)
class DescentSettings:
    """All parameters of a descent."""

    descent: DescentParameters = field(default_factory=DescentParameters)
    link: WinchLinkParameters = field(default_factory=WinchLinkParameters)
    hanging_controller: HangingControllerParameters = field(
        default_factory=HangingControllerParameters
    )
