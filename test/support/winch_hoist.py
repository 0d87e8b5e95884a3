"""Reduced-order plant of the winch: drum, elastic tether with mass, swinging point mass.

The drum is the simulator's. The tether is one spring along the line from the fairlead to the
rover, E A (l - L)/L with strain-rate damping, without compression; its weight hangs on the fairlead
and a third of its mass moves with the rover. The rover hangs or rests on a floor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rover_sim.physics.mechanisms import drum as drums
from rover_sim.physics.numerics.compiled import checked
from tether_winch.servo import ServoCommand

TICK_NS = 10_000_000  # of controllers and sensors
TICK = TICK_NS * 1e-9
_SUBSTEP = 1e-3


class Readings(NamedTuple):
    """Error-free readings of the winch sensors."""

    length: float  # payout [m]
    rate: float  # payout rate [m/s]
    brake_is_open: bool
    current: float  # of the motor [A], > 0 pays out
    tension: float  # at the fairlead [N]


@dataclass(frozen=True)
class HoistParameters:
    """Parameters of the hoist."""

    mass: float = 10.0  # rover [kg]
    axial_stiffness: float = 2.0e4  # EA [N]
    line_density: float = 0.005  # [kg/m]
    damping_time: float = 0.015  # strain-rate damping [s]
    gravity: float = 1.62  # [m/s^2]
    floor_depth: float = math.inf  # below the fairlead [m]
    floor_stiffness: float = 2.0e4  # [N/m^1.5]
    swing: float = 0.0  # start angle [rad]
    swing_damping: float = 0.002  # decay rate of the lateral speed [1/s]
    start_length: float = 2.0  # [m]
    drum: drums.DrumParameters = field(default_factory=drums.DrumParameters)
    max_length: float = 60.0  # of the tether [m]


class _Body(NamedTuple):
    x: float
    z: float
    vx: float
    vz: float


class _Constants(NamedTuple):
    mass: float
    stiffness: float
    density: float
    damping_time: float
    gravity: float
    floor: float
    floor_stiffness: float
    swing_damping: float


@checked
def _march(
    constants: _Constants,
    drum: drums.Drum,
    state: drums.DrumState,
    command: drums.DrumCommand,
    body: _Body,
    steps: int,
    h: float,
) -> tuple[drums.DrumState, _Body, float, float, float, float]:
    """Advance; returns states, last tension and current, peak tension, force of the floor."""
    x, z, vx, vz = body
    tension = 0.0
    peak = 0.0
    floor = 0.0
    current = 0.0
    for _ in range(steps):
        length = state.length
        away = math.sqrt(x * x + z * z)
        mass = constants.mass + constants.density * length / 3.0
        closing = (x * vx + z * vz) / away - state.rate * drum.radius
        strain = (away - length) / length
        tip = constants.stiffness * (strain + constants.damping_time * closing / length)
        if strain <= 0.0 or tip < 0.0:
            tip = 0.0
        weight = constants.density * constants.gravity * min(length, abs(z))
        tension = tip + weight
        peak = max(peak, tension)
        state, outputs, _energies = drums.advance(drum, state, command, tension, h)
        current = outputs.current
        fx = -tip * x / away - constants.swing_damping * mass * vx
        fz = -tip * z / away - mass * constants.gravity
        depth = -constants.floor - z
        floor = 0.0
        if depth > 0.0:
            floor = constants.floor_stiffness * depth**1.5 * max(0.0, 1.0 - 0.75 * vz)
            fz += floor
            fx -= 0.6 * floor * math.tanh(vx / 0.005)
        vx += h * fx / mass
        vz += h * fz / mass
        x += h * vx
        z += h * vz
    return state, _Body(x, z, vx, vz), tension, current, peak, floor


class Hoist:
    """A plant for a winch controller.

    Args:
        parameters: of one hoist.
    """

    def __init__(self, parameters: HoistParameters) -> None:
        self.parameters = p = parameters
        self._drum = drums.make_drum(p.drum, p.max_length)
        self._state = drums.initial_state(self._drum, p.start_length)
        weight = p.mass * p.gravity
        stretched = p.start_length * (1.0 + weight / p.axial_stiffness)
        start = min(stretched * math.cos(p.swing), p.floor_depth)
        self._body = _Body(stretched * math.sin(p.swing), -start, 0.0, 0.0)
        self._constants = _Constants(
            p.mass, p.axial_stiffness, p.line_density, p.damping_time, p.gravity,
            min(p.floor_depth, 1e9), p.floor_stiffness, p.swing_damping,
        )  # fmt: skip
        self.time = 0.0
        self.peak_tension = 0.0
        self.floor_force = 0.0  # [N]

    @property
    def position(self) -> NDArray[np.float64]:
        """Position of the rover: lateral, up [m]."""
        return np.array([self._body.x, self._body.z])

    @property
    def depth(self) -> float:
        """Depth of the rover below the fairlead [m]."""
        return -self._body.z

    @property
    def is_supported(self) -> bool:
        """Whether the floor carries more than half of the rover."""
        return self.floor_force > 0.5 * self.parameters.mass * self.parameters.gravity

    @property
    def slack(self) -> float:
        """Slack: tether length less the distance to the rover [m]."""
        return max(0.0, self._state.length - math.hypot(self._body.x, self._body.z))

    def step(self, command: ServoCommand | None, dt: float) -> Readings:
        """Advance under a command; None = the drive has no command."""
        self._state, self._body, tension, current, peak, self.floor_force = _march(
            self._constants, self._drum, self._state, self._drum_command(command), self._body,
            round(dt / _SUBSTEP), _SUBSTEP,
        )  # fmt: skip
        self.peak_tension = max(self.peak_tension, peak)
        self.time += dt
        s = self._state
        radius = drums.radius_at(self._drum, self._drum.full_turns - s.angle / (2.0 * math.pi))
        return Readings(s.length, s.rate * radius, not s.braked, current, tension)

    def _drum_command(self, command: ServoCommand | None) -> drums.DrumCommand:
        if command is None:
            return drums.DrumCommand(0, 0.0, 0.0, 0.0, False)
        arm = self._drum.radius / self._drum.gear_ratio
        return drums.DrumCommand(
            2, -command.feed_forward * arm, command.rate, command.limit * arm, command.release_brake
        )
