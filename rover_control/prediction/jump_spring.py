"""Jump height as a function of the spring's stroke, estimated from measured jumps. Pure.

A spring compressed by x accelerates Body 2, which then takes Body 1 along with conserved momentum.
With spring rate k, masses m1 and m2, M = m1 + m2 and gravity g the rover rises by

    H(x) = c m2 (k x^2 - 2 m2 g x) / (2 g M^2) cos^2(tilt)

where the factor c accounts for the end stop, the travel of Body 2 and losses. Two errors are
estimated: a of log H (spring rate, losses) and b of the stroke (zero of the nut). A further factor
`ratio` describes the influence of a place, such as tether slack and attitude; it is given or 1.
Each jump measures log H(x + b) + a; a Kalman filter with the two states a and b uses it. The stroke
error of a single jump enters as measurement noise, uniformly distributed up to its tolerance, so
the distribution of an expected height is flatter and has shorter tails than a normal one.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_schemas.parameters import parameter

_OUTLIER = 4.0  # innovation beyond which a jump is rejected, in standard deviations
_NORMAL = NormalDist()
_TAIL = 9.0  # support of the distributions, in standard deviations
_CELLS = 1 << 40  # of the support, in which quantiles are searched
_NARROW = 1.0e-3  # ratio of the two errors below which the smaller one is neglected
_ROOT_3 = math.sqrt(3.0)


@dataclass(frozen=True)
class SpringParameters:
    """Nominal jump mechanism and its uncertainty."""

    spring_rate: float = parameter(824.0, "N/m", "rate of the jump spring", 1.0, 1e5)
    rover_mass: float = parameter(10.0, "kg", "mass of both bodies", 0.1, 1e3)
    body2_mass: float = parameter(4.0, "kg", "mass of Body 2", 0.01, 1e3)
    jump_gravity: float = parameter(1.62, "m/s^2", "gravity where the rover jumps", 0.01, 30.0)
    height_gain: float = parameter(
        1.03, "-", "height over that of the energy and momentum balance", 0.1, 2.0
    )
    height_gain_std: float = parameter(
        0.035, "-", "standard deviation of the height gain before the first jump", 0.0, 0.5,
        read_only=True,
    )  # fmt: skip
    nut_zero_std: float = parameter(
        1.0e-3, "m", "standard deviation of the nut's zero before the first jump", 0.0, 0.02,
        read_only=True,
    )  # fmt: skip
    stroke_tolerance: float = parameter(
        2.0e-3, "m", "bound of the stroke error of each jump, uniformly distributed", 0.0, 0.02
    )
    height_measurement_std: float = parameter(
        2.0e-3, "m", "standard deviation of a measured height", 1e-4, 0.1
    )
    height_model_std: float = parameter(
        4.0e-3, "-", "relative standard deviation of the height from other causes", 1e-4, 0.5
    )


class Height(NamedTuple):
    """Probability distribution of an expected height.

    The logarithm of the true height over `mean` is the sum of a normal and a uniform error.
    """

    mean: float  # [m]
    spread: float  # standard deviation of the normal error
    tolerance: float = 0.0  # bound of the uniform error

    @property
    def deviation(self) -> float:
        """Standard deviation of the logarithm."""
        return math.hypot(self.spread, self.tolerance / _ROOT_3)

    def quantile(self, probability: float) -> float:
        """Height [m] at a probability of the cumulative distribution."""
        bound = self.tolerance + _TAIL * self.spread
        if bound == 0.0:
            return self.mean

        def error(cell: int) -> float:
            return (2.0 * cell / _CELLS - 1.0) * bound

        # scipy's root finders and distributions would double the time that a node takes to start.
        cell = bisect_left(range(_CELLS), probability, key=lambda cell: self._below(error(cell)))
        return self.mean * math.exp(error(cell))

    def interval(self, factor: float = 0.9) -> tuple[float, float]:
        """Central interval [m] of a probability."""
        outside = 0.5 * (1.0 - factor)
        return self.quantile(outside), self.quantile(1.0 - outside)

    def spread_by(self, spread: float) -> Height:
        """The same with an additional normal error of the logarithm."""
        return self._replace(spread=math.hypot(self.spread, spread))

    def _below(self, error: float) -> float:
        """Cumulative distribution of the logarithmic error."""
        if self.tolerance < _NARROW * self.spread:
            return _NORMAL.cdf(error / self.deviation)
        if self.spread < _NARROW * self.tolerance:
            return min(max(0.5 + 0.5 * error / self.tolerance, 0.0), 1.0)
        high = (error + self.tolerance) / self.spread
        low = (error - self.tolerance) / self.spread
        return (
            0.5
            * self.spread
            / self.tolerance
            * (_normal_cdf_integral(high) - _normal_cdf_integral(low))
        )


def _normal_cdf_integral(deviations: float) -> float:
    """Integral of the standard normal cumulative distribution."""
    density = math.exp(-0.5 * deviations**2) / math.sqrt(math.tau)
    return deviations * _NORMAL.cdf(deviations) + density


class SpringEstimate:
    """Estimate of the spring.

    Args:
        parameters: nominal mechanism and its uncertainty.

    Attributes:
        jumps: number of jumps used.
    """

    def __init__(self, parameters: SpringParameters) -> None:
        self.parameters = parameters
        self.jumps = 0
        self._mean: NDArray[np.float64] = np.zeros(2)  # a, b [m]
        self._cov = np.diag([parameters.height_gain_std**2, parameters.nut_zero_std**2])

    @property
    def gain(self) -> float:
        """Estimated factor of the height over the nominal one."""
        return math.exp(float(self._mean[0]))

    @property
    def zero(self) -> float:
        """Estimated excess of the stroke over the nut's position [m]."""
        return float(self._mean[1])

    @property
    def shortest_stroke(self) -> float:
        """Shortest stroke that lifts Body 2 [m]."""
        p = self.parameters
        return max(2.0 * p.body2_mass * p.jump_gravity / p.spring_rate - self.zero, 0.0)

    def expected(self, stroke: float, tilt: float = 0.0, ratio: float = 1.0) -> Height:
        """Expected height of a jump.

        Args:
            stroke: of the nut [m], above `shortest_stroke`.
            tilt: of base_link z [rad].
            ratio: factor of the height at this place.

        Raises:
            ValueError: the stroke is too short to lift Body 2.
        """
        mean, row = self._model(stroke, tilt, ratio)
        p = self.parameters
        spread = float(row @ self._cov @ row) + p.height_model_std**2
        return Height(mean, math.sqrt(spread), float(row[1]) * p.stroke_tolerance)

    def reach(self, stroke: float, tilt: float = 0.0, ratio: float = 1.0) -> float:
        """Expected height [m], as in `expected`; 0 where the stroke is too short to lift Body 2."""
        lifts = stroke > self.shortest_stroke
        return self.expected(stroke, tilt, ratio).mean if lifts else 0.0

    def stroke_for(self, height: float, tilt: float = 0.0, ratio: float = 1.0) -> float:
        """Stroke [m] for an expected height [m]; tilt [rad] and ratio as in `expected`.

        Raises:
            ValueError: the height is not above 0.
        """
        if not (math.isfinite(height) and height > 0.0):
            raise ValueError(f"height = {height!r} m: must be finite and above 0 m")
        p = self.parameters
        weight = p.body2_mass * p.jump_gravity
        factor = ratio * p.height_gain * self.gain * math.cos(tilt) ** 2
        work = height * 2.0 * p.jump_gravity * p.rover_mass**2 / (p.body2_mass * factor)
        return (weight + math.sqrt(weight**2 + p.spring_rate * work)) / p.spring_rate - self.zero

    def update(self, stroke: float, height: float, tilt: float = 0.0, ratio: float = 1.0) -> bool:
        """Update the estimate with a measured jump; False if it is rejected as an outlier.

        Args:
            stroke: of the nut at the release [m].
            height: measured [m].
            tilt: of base_link z before the jump [rad].
            ratio: factor of the height at this place.
        """
        if not (math.isfinite(height) and height > 0.0) or stroke <= self.shortest_stroke:
            return False
        mean, row = self._model(stroke, tilt, ratio)
        p = self.parameters
        error = (p.height_measurement_std / mean) ** 2 + p.height_model_std**2
        error += (row[1] * p.stroke_tolerance) ** 2 / 3.0
        innovation = math.log(height / mean)
        spread = float(row @ self._cov @ row) + error
        if innovation**2 > _OUTLIER**2 * spread:
            return False
        gain = self._cov @ row / spread
        self._mean = self._mean + gain * innovation
        remaining = np.eye(2) - np.outer(gain, row)
        self._cov = remaining @ self._cov @ remaining.T + error * np.outer(gain, gain)
        self.jumps += 1
        return True

    def sample_errors(self, generator: np.random.Generator, count: int) -> NDArray[np.float64]:
        """Random height factors and stroke errors [m] from the present distribution, (count, 2)."""
        p = self.parameters
        errors = generator.multivariate_normal(self._mean, self._cov, count)
        errors[:, 0] = np.exp(errors[:, 0] + p.height_model_std * generator.standard_normal(count))
        errors[:, 1] += p.stroke_tolerance * generator.uniform(-1.0, 1.0, count)
        return np.asarray(errors)

    def equivalent_stroke(self, stroke: float, gain: float, zero: float) -> float:
        """Stroke [m] of the nominal spring that gives the height of a spring with errors.

        Args:
            stroke: of the nut [m].
            gain: factor of the height.
            zero: error of the stroke [m].
        """
        p = self.parameters
        x, weight = stroke + zero, p.body2_mass * p.jump_gravity
        work = gain * (p.spring_rate * x**2 - 2.0 * weight * x)
        return (weight + math.sqrt(weight**2 + p.spring_rate * max(work, 0.0))) / p.spring_rate

    def nominal_height(self, stroke: float, tilt: float = 0.0) -> float:
        """Height [m] of the nominal mechanism, without the estimate.

        Raises:
            ValueError: the stroke is too short to lift Body 2.
        """
        return SpringEstimate(self.parameters).expected(stroke, tilt).mean

    def _model(self, stroke: float, tilt: float, ratio: float) -> tuple[float, NDArray[np.float64]]:
        """Mean height [m] and the derivatives of its logarithm with respect to a and b."""
        p = self.parameters
        x, weight = stroke + self.zero, p.body2_mass * p.jump_gravity
        work = p.spring_rate * x**2 - 2.0 * weight * x
        if not work > 0.0:
            raise ValueError(
                f"stroke = {stroke!r} m: must be above {self.shortest_stroke:.4g} m to lift Body 2"
            )
        factor = ratio * p.height_gain * self.gain * math.cos(tilt) ** 2
        mean = factor * p.body2_mass * work / (2.0 * p.jump_gravity * p.rover_mass**2)
        return mean, np.array([1.0, (2.0 * p.spring_rate * x - 2.0 * weight) / work])
