"""Pictures of a descent, each with the camera's report once that is received. Pure."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from msg_schemas import machine
from msg_schemas.samples import JointSample
from rover_control.hanging.descent_parameters import DescentParameters
from rover_control.hanging.hanging_controller import Exposure

_NANO = 1e9


class Observation(NamedTuple):
    """A picture with the camera's report."""

    number: int  # since the start, from 1
    exposure: Exposure
    smear: float  # [px]; NaN = no report
    wall_distance: float  # [m]; NaN = no report


class ObservationQueue:
    """Assigns the camera's reports to the pictures.

    Args:
        parameters: latency and timeout of the reports.
    """

    def __init__(self, parameters: DescentParameters) -> None:
        self.parameters = parameters
        self._count = 0  # pictures since the start
        self._pending: deque[Observation] = deque()
        self._completed: list[Observation] = []

    def add(self, exposure: Exposure) -> None:
        """Add a picture, which waits for its report."""
        self._count += 1
        self._pending.append(Observation(self._count, exposure, math.nan, math.nan))

    def on_camera(self, sample: JointSample) -> None:
        """Complete the pictures that the camera's report covers."""
        smear, wall = (
            sample.joints[name].position for name in (machine.SMEAR, machine.WALL_DISTANCE)
        )
        ready = sample.stamp_ns - round(self.parameters.exposure_latency * _NANO)
        while self._pending and round(self._pending[0].exposure.time * _NANO) <= ready:
            done = self._pending.popleft()
            self._completed.append(done._replace(smear=smear, wall_distance=wall))

    def expire(self, now: float) -> None:
        """Complete the pictures whose report is overdue at a time [s], without one."""
        timeout = self.parameters.camera_timeout
        while self._pending and now - self._pending[0].exposure.time > timeout:
            self._completed.append(self._pending.popleft())

    def take(self) -> list[Observation]:
        """Return the pictures completed since the last call, and clear them."""
        taken, self._completed = self._completed, []
        return taken
