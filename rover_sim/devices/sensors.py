"""Sensor models: readings from the true state, with noise, bias, delay, saturation, resolution.

`SensorSuite.step` computes the readings from the truth at the end of a tick. Its state is immutable
and the step is deterministic. A reading is computed in this order: the true signal, late by `delay`
(interpolated linearly between ticks, the range finder's held); the scale; the bias, with a random
initial value and a random walk; white noise; saturation at the range; the resolution. White noise
is given by its density N, with the standard deviation N/sqrt(dt) in a tick of dt, and the random
walk of the bias by its density K, with K sqrt(dt) in a tick; so both are independent of the tick.
All random numbers derive from the seed, the number of the tick and the channel. The rate of an
encoder with errors is the difference of its readings over the tick; the nut's position is the jump
motor's encoder times the screw's pitch.

The gyro measures the mean angular velocity of the tick (from the rotation between its start and
end), the accelerometer the mean specific force at its position (the change of velocity minus
gravity), as do sensors that integrate over their sample.

Vectors are in base_link; SI units.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from rover_sim.physics.ground.ray import distance_to_ground
from rover_sim.physics.ground.terrain import Terrain
from rover_sim.physics.numerics.vectors import Vector, dot
from rover_sim.physics.rover.body_motion import (
    BodyMotion,
    camera_ray,
    image_rate,
    mean_rate,
    specific_force,
)
from rover_sim.physics.tether.ancf import Array
from rover_sim.scenarios.sensor_sections import SensorSettings

# --------------------------------------------------------------------------- truth and readings


@dataclass(frozen=True)
class Truth:
    """True values of all measured quantities at the end of a tick."""

    time: float  # [s]
    body: BodyMotion | None = None  # None: no rover
    nut: float = 0.0  # position as compression of the spring [m]
    flywheel_angle: float = 0.0  # [rad]
    flywheel_rate: float = 0.0  # relative to Body 1 [rad/s]
    wheel_angles: tuple[float, float] = (0.0, 0.0)  # left, right [rad]
    wheel_rates: tuple[float, float] = (0.0, 0.0)  # relative to Body 1 [rad/s]
    length: float = 0.0  # paid out [m]
    payout_rate: float = 0.0  # [m/s]
    brake_closed: bool = True
    currents: Vector = (0.0, 0.0, 0.0)  # of jump, wheel and winch motor [A]
    fairlead_tension: float = 0.0  # [N]
    rover_tension: float = 0.0  # [N]
    wheel_loads: tuple[float, float] = (0.0, 0.0)  # of the ground on the wheels [N]
    body_load: float = 0.0  # of the ground on corners and tail [N]


@dataclass(frozen=True)
class Readings:
    """Readings of the sensors at the end of a tick."""

    time: float  # [s]
    gyro: Vector  # [rad/s]
    specific_force: Vector  # [m/s^2]
    nut: float  # [m]
    nut_rate: float  # [m/s]
    flywheel_angle: float  # [rad]
    flywheel_rate: float  # [rad/s]
    wheel_angles: tuple[float, float]  # left, right [rad]
    wheel_rates: tuple[float, float]  # [rad/s]
    length: float  # [m]
    payout_rate: float  # [m/s]
    brake_closed: bool
    currents: Vector  # of jump, wheel and winch motor [A]
    fairlead_tension: float  # [N]
    rover_tension: float  # [N]
    wheel_contacts: tuple[bool, bool]  # left, right
    body_contact: bool
    wall_distance: float  # [m]; inf: out of range
    smear: float  # of the image of the wall over the exposure [px]

    @property
    def on_ground(self) -> bool:
        """Whether a wheel or a body touches the ground."""
        return self.body_contact or any(self.wheel_contacts)


_ROUNDING = 1e-9
"""Time by which a signal may be newer than a delay says [s]."""


class _Row(IntEnum):
    """Indices into the array of all signals."""

    GYRO = 0
    FORCE = 3
    NUT = 6
    FLYWHEEL = 7
    FLYWHEEL_RATE = 8
    WHEELS = 9
    WHEEL_RATES = 11
    LENGTH = 13
    PAYOUT = 14
    CURRENTS = 15
    FAIRLEAD = 18
    ROVER = 19
    WALL = 20
    SIZE = 21


@dataclass(frozen=True, eq=False)
class SensorState:
    """State of the sensors; immutable like the plant's states."""

    tick: int
    truth: Truth
    bias: Array  # (SIZE,)
    signals: tuple[tuple[float, Array], ...]  # time [s] and signals, as far as delays need them
    angles: Array  # last readings, for the encoders' rates, (SIZE,)
    image: tuple[tuple[float, float, float], ...]  # time [s] and position of the image [rad]

    def with_yaw_bias(self, bias: float) -> SensorState:
        """Return the state with another bias of the gyro about z [rad/s]."""
        changed = self.bias.copy()
        changed[_Row.GYRO + 2] = bias
        return replace(self, bias=changed)


# ------------------------------------------------------------------------------------ measuring


def spread(points: Sequence[tuple[float, float]]) -> float:
    """Return the largest distance between two of the points of a plane."""
    # No arrays: for the few points of an exposure they take five times as long.
    squares = ((x - u) * (x - u) + (y - v) * (y - v) for (x, y), (u, v) in combinations(points, 2))
    return math.sqrt(max(squares, default=0.0))


class SensorSuite:
    """The sensors of a scenario.

    Args:
        parameters: of the sensors.
        gravity: magnitude [m/s^2].
        pitch: travel of the nut per angle of the jump motor's shaft [m/rad].
        terrain: in the camera's view; None: none.
        seed: of the errors, in place of the parameters' seed.
    """

    def __init__(
        self,
        parameters: SensorSettings,
        gravity: float,
        *,
        pitch: float = 0.0,
        terrain: Terrain | None = None,
        seed: int | None = None,
    ) -> None:
        self.parameters = parameters
        self._gravity = gravity
        self._pitch = pitch
        self._terrain = terrain
        bits = np.random.Philox(key=parameters.seed if seed is None else seed)
        # Access the bit generator through the generator only: in numpy 1.26 a copy of a generator
        # has a bit generator of its own.
        self._generator = np.random.Generator(bits)
        self._start = bits.state
        self._noise, self._bias, self._walk, self._resolution = np.zeros((4, _Row.SIZE))
        self._range = np.full(_Row.SIZE, math.inf)
        self._scale = np.ones(_Row.SIZE)
        self._delay = np.zeros(_Row.SIZE)
        if parameters.error_model == "full":
            self._set_errors(parameters)
        self._longest_delay = float(self._delay.max())
        (self._quantised_rows,) = np.nonzero(self._resolution > 0.0)
        self._steps = self._resolution[self._quantised_rows]
        rate_of = {
            _Row.FLYWHEEL: _Row.FLYWHEEL_RATE,
            _Row.WHEELS: _Row.WHEEL_RATES,
            _Row.WHEELS + 1: _Row.WHEEL_RATES + 1,
            _Row.LENGTH: _Row.PAYOUT,
        }
        self._encoders = np.array([row for row in rate_of if self._has_errors(row)], int)
        self._encoder_rates = np.array([rate_of[row] for row in self._encoders], int)
        look = _unit(parameters.camera.axis)
        self._look = _vector(look.tolist())
        self._sides = tuple(_vector(side.tolist()) for side in _sides_of(look))

    def _set_errors(self, p: SensorSettings) -> None:
        in_radians = ("noise_density", "bias", "bias_random_walk", "resolution")
        nut = replace(
            p.flywheel_encoder,
            range=p.flywheel_encoder.range * (self._pitch or math.inf),
            **{name: getattr(p.flywheel_encoder, name) * self._pitch for name in in_radians},
        )
        for first, count, channel in (
            (_Row.GYRO, 3, p.gyro),
            (_Row.FORCE, 3, p.accelerometer),
            (_Row.NUT, 1, nut),
            (_Row.FLYWHEEL, 1, p.flywheel_encoder),
            (_Row.WHEELS, 2, p.wheel_encoders),
            (_Row.LENGTH, 1, p.drum_encoder),
            (_Row.CURRENTS, 3, p.currents),
            (_Row.FAIRLEAD, 1, p.fairlead_load_cell),
            (_Row.ROVER, 1, p.rover_load_cell),
            (_Row.WALL, 1, p.camera.range_finder),
        ):
            rows = slice(first, first + count)
            self._scale[rows] = channel.scale
            self._noise[rows] = channel.noise_density
            self._bias[rows] = channel.bias
            self._walk[rows] = channel.bias_random_walk
            self._range[rows] = channel.range
            self._resolution[rows] = channel.resolution
            self._delay[rows] = channel.delay

    def _has_errors(self, row: int) -> bool:
        """Whether the readings of a channel differ from its true signal."""
        added = self._noise, self._bias, self._walk, self._resolution, self._delay
        return (
            any(each[row] > 0.0 for each in added)
            or self._scale[row] != 1.0
            or bool(self._range[row] < math.inf)
        )

    def start(self, truth: Truth) -> SensorState:
        """Return the state at the start of the sensors, with random biases."""
        row, bias = self._signals(truth, truth, 0.0), self._bias * self._numbers(0)
        return SensorState(
            0,
            truth,
            bias,
            ((truth.time, row),),
            self._as_read(self._scale * row + bias),
            ((truth.time, 0.0, 0.0),),
        )

    def step(self, state: SensorState, truth: Truth) -> tuple[SensorState, Readings]:
        """Measure at the end of a tick that began at the state's truth.

        Raises:
            ValueError: the time is not after the state's.
        """
        dt = truth.time - state.truth.time
        if not dt > 0.0:
            raise ValueError(f"time = {truth.time}: must be after {state.truth.time} s")
        tick = state.tick + 1
        now = self._signals(state.truth, truth, dt)
        signals = self._kept((*state.signals, (truth.time, now)))
        row = self._late(signals, truth.time)
        numbers = self._numbers(tick)
        bias = state.bias + self._walk * math.sqrt(dt) * numbers[0]
        read = self._scale * row + bias + self._noise / math.sqrt(dt) * numbers[1]
        read = self._as_read(read)
        encoders = self._encoders
        read[self._encoder_rates] = (read[encoders] - state.angles[encoders]) / dt
        image, smear = self._smear(state, truth, now[_Row.WALL], dt)
        after = SensorState(tick, truth, bias, signals, read, image)
        return after, self._readings(truth, read, smear)

    def _numbers(self, tick: int) -> Array:
        """Return standard normal numbers of a tick, (2, SIZE): for the walks and the noise."""
        # Set the counter to the tick's number: a new generator takes five times as long.
        start = self._start
        start["state"]["counter"][:] = (0, 0, tick, 0)
        self._generator.bit_generator.state = start
        drawn = self._generator.standard_normal((2, _Row.SIZE))
        drawn[:, _Row.NUT] = drawn[:, _Row.FLYWHEEL]
        return drawn if tick else drawn[0]

    def _signals(self, before: Truth, after: Truth, dt: float) -> Array:
        """Return all signals without errors, (SIZE,)."""
        spin: Sequence[float] = (0.0, 0.0, 0.0)
        force: Sequence[float] = spin
        if after.body is not None:
            spin = after.body.spin
            if before.body is not None and dt > 0.0:
                spin = mean_rate(before.body.orientation, after.body.orientation, dt)
                force = specific_force(
                    before.body, after.body, self.parameters.imu_position, self._gravity, dt
                )
        # In the order of `_Row`.
        return np.array((
            *spin, *force, after.nut, after.flywheel_angle, after.flywheel_rate,
            *after.wheel_angles, *after.wheel_rates, after.length, after.payout_rate,
            *after.currents, after.fairlead_tension, after.rover_tension,
            self._wall_distance(after.body),
        ))  # fmt: skip

    def _wall_distance(self, body: BodyMotion | None) -> float:
        if body is None or self._terrain is None:
            return math.inf
        camera = self.parameters.camera
        place, look = camera_ray(body, camera.position, self._look)
        return float(distance_to_ground(self._terrain, place, look, camera.max_range))

    def _kept(self, signals: tuple[tuple[float, Array], ...]) -> tuple[tuple[float, Array], ...]:
        """Drop the signals that are older than the longest delay."""
        oldest = signals[-1][0] - self._longest_delay
        first = 0
        while first + 1 < len(signals) and signals[first + 1][0] <= oldest:
            first += 1
        return signals[first:]

    def _late(self, signals: tuple[tuple[float, Array], ...], now: float) -> Array:
        """Return the signals, each late by its delay."""
        if self._longest_delay == 0.0:
            return signals[-1][1]
        instants = np.array([instant for instant, _ in signals])
        rows = np.array([row for _, row in signals])
        late = np.empty(_Row.SIZE)
        for k in range(_Row.WALL):
            late[k] = np.interp(now - self._delay[k], instants, rows[:, k])
        # The distance jumps where the ray leaves the ground, to infinity: nothing lies between.
        seen = np.searchsorted(instants, now - self._delay[_Row.WALL] + _ROUNDING, "right") - 1
        late[_Row.WALL] = rows[max(int(seen), 0), _Row.WALL]
        return late

    def _as_read(self, row: Array) -> Array:
        """Return signals with their errors as they are read: within the range, quantised."""
        read: Array = np.minimum(np.maximum(row, -self._range), self._range)
        rows, steps = self._quantised_rows, self._steps
        read[rows] = np.rint(read[rows] / steps) * steps
        return read

    def _smear(
        self, state: SensorState, truth: Truth, distance: float, dt: float
    ) -> tuple[tuple[tuple[float, float, float], ...], float]:
        """Return the path of the image during the last exposure, and its extent [px]."""
        camera = self.parameters.camera
        if truth.body is None or state.truth.body is None:
            return state.image, 0.0
        before = image_rate(state.truth.body, camera.position, self._look, distance)
        after = image_rate(truth.body, camera.position, self._look, distance)
        _, x, y = state.image[-1]
        side_x, side_y = (0.5 * dt * (dot(side, before) + dot(side, after)) for side in self._sides)
        image = (*state.image, (truth.time, x + side_x, y + side_y))
        opened = truth.time - camera.exposure * (1.0 + 1e-9)
        while len(image) > 2 and image[1][0] <= opened:
            image = image[1:]
        if image[0][0] < opened:  # the shutter opened between two ticks
            (t0, x0, y0), (t1, x1, y1) = image[:2]
            share = (opened - t0) / (t1 - t0)
            first = (x0 + share * (x1 - x0), y0 + share * (y1 - y0))
            points = [first, *((px, py) for _, px, py in image[1:])]
        else:
            points = [(px, py) for _, px, py in image]
        return image, spread(points) / camera.pixel_angle

    def _readings(self, truth: Truth, row: Array, smear: float) -> Readings:
        values = row.tolist()
        threshold = self.parameters.contact_threshold
        return Readings(
            time=truth.time,
            gyro=_vector(values[_Row.GYRO : _Row.GYRO + 3]),
            specific_force=_vector(values[_Row.FORCE : _Row.FORCE + 3]),
            nut=values[_Row.NUT],
            nut_rate=values[_Row.FLYWHEEL_RATE] * self._pitch,
            flywheel_angle=values[_Row.FLYWHEEL],
            flywheel_rate=values[_Row.FLYWHEEL_RATE],
            wheel_angles=(values[_Row.WHEELS], values[_Row.WHEELS + 1]),
            wheel_rates=(values[_Row.WHEEL_RATES], values[_Row.WHEEL_RATES + 1]),
            length=values[_Row.LENGTH],
            payout_rate=values[_Row.PAYOUT],
            brake_closed=truth.brake_closed,
            currents=_vector(values[_Row.CURRENTS : _Row.CURRENTS + 3]),
            fairlead_tension=values[_Row.FAIRLEAD],
            rover_tension=values[_Row.ROVER],
            wheel_contacts=(truth.wheel_loads[0] > threshold, truth.wheel_loads[1] > threshold),
            body_contact=truth.body_load > threshold,
            wall_distance=values[_Row.WALL],
            smear=smear,
        )


def _unit(vector: ArrayLike) -> Array:
    array = np.asarray(vector, dtype=np.float64)
    return np.asarray(array / np.linalg.norm(array))


def _sides_of(look: Array) -> Array:
    """Return two unit vectors perpendicular to a unit vector, (2, 3)."""
    helper = np.array([0.0, 0.0, 1.0]) if abs(look[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    first = _unit(np.cross(helper, look))
    return np.stack([first, np.cross(look, first)])


def _vector(values: list[float]) -> Vector:
    x, y, z = values
    return (x, y, z)
