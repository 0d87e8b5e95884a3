"""How high a stroke of the spring throws the rover, learnt from the jumps flown. Pure.

A spring compressed by x throws Body 2 up, which takes Body 1 along (momentum is kept): with the
rate k, the masses m1 and m2, M = m1 + m2 and gravity g the rover rises by

    H(x) = c m2 (k x^2 - 2 m2 g x) / (2 g M^2) cos^2(tilt)

where c takes in what the end stop and Body 2's travel add and the losses take. Two things about it
are not known well: a, by which log H is off (spring rate, losses), and b, by which the stroke is
off (zero of the nut). A ratio by which a place makes jumps higher than the formula has them, as the
slack of the tether or the attitude may, is known from elsewhere or 1. Each jump tells
log H(x + b) + a with an error; a and b follow as the two-state Kalman filter has them. The stroke's
own error counts as a part of that error: any up to its tolerance is equally likely, so that the
heights that are expected are less peaked than a normal distribution, and not as wide in the tails.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ndtr

from msg_schemas.parameters import parameter

_OUTLIER = 4.0  # a jump further off than so many standard deviations teaches nothing
_TAIL = 9.0  # standard deviations beyond which nothing is expected
_NARROW = 1.0e-3  # part of the other error up to which one does not change the quantiles
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
        0.035, "-", "standard deviation of the height gain before the first jump", 0.0, 0.5
    )
    nut_zero_std: float = parameter(
        1.0e-3, "m", "standard deviation of the nut's zero before the first jump", 0.0, 0.02
    )
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
    """A height that is expected.

    The logarithm of the true one over `mean` is the sum of a normally distributed error and of one
    of which each value up to a tolerance is equally likely.
    """

    mean: float  # [m]
    spread: float  # standard deviation of the normally distributed one
    tolerance: float = 0.0  # of the other one

    @property
    def deviation(self) -> float:
        """Standard deviation of the logarithm."""
        return math.hypot(self.spread, self.tolerance / _ROOT_3)

    def quantile(self, probability: float) -> float:
        """The height that the true one stays below with so large a probability [m]."""
        most = self.tolerance + _TAIL * self.spread
        if most == 0.0:
            return self.mean
        error = brentq(lambda e: self._below(e) - probability, -most, most)
        return self.mean * math.exp(error)

    def interval(self, share: float = 0.9) -> tuple[float, float]:
        """The heights between which the true one lies with so large a probability [m]."""
        outside = 0.5 * (1.0 - share)
        return self.quantile(outside), self.quantile(1.0 - outside)

    def spread_by(self, spread: float) -> Height:
        """The same with a further normally distributed error of its logarithm."""
        return self._replace(spread=math.hypot(self.spread, spread))

    def _below(self, error: float) -> float:
        """Probability that the logarithm is off by less than this."""
        if self.tolerance < _NARROW * self.spread:
            return float(ndtr(error / self.deviation))
        if self.spread < _NARROW * self.tolerance:
            return min(max(0.5 + 0.5 * error / self.tolerance, 0.0), 1.0)
        high = (error + self.tolerance) / self.spread
        low = (error - self.tolerance) / self.spread
        return 0.5 * self.spread / self.tolerance * (_summed(high) - _summed(low))


def _summed(deviations: float) -> float:
    """The integral of the standard normal distribution up to here."""
    density = math.exp(-0.5 * deviations**2) / math.sqrt(math.tau)
    return float(deviations * ndtr(deviations)) + density


class SpringEstimate:
    """What is known of the spring.

    Args:
        parameters: of the mechanism.

    Attributes:
        jumps: from how many it has learnt.
    """

    def __init__(self, parameters: SpringParameters) -> None:
        self.parameters = parameters
        self.jumps = 0
        self._mean: NDArray[np.float64] = np.zeros(2)  # a, b [m]
        self._cov = np.diag([parameters.height_gain_std**2, parameters.nut_zero_std**2])

    @property
    def gain(self) -> float:
        """By how much heights are larger than the parameters say."""
        return math.exp(float(self._mean[0]))

    @property
    def zero(self) -> float:
        """By how much strokes are longer than the nut says [m]."""
        return float(self._mean[1])

    @property
    def shortest_stroke(self) -> float:
        """Below it the spring lifts nothing [m]."""
        p = self.parameters
        return max(2.0 * p.body2_mass * p.jump_gravity / p.spring_rate - self.zero, 0.0)

    def expected(self, stroke: float, tilt: float = 0.0, ratio: float = 1.0) -> Height:
        """The height of a jump.

        Args:
            stroke: of the nut [m], above `shortest_stroke`.
            tilt: of base_link z [rad].
            ratio: of the height to the formula's.

        Raises:
            ValueError: the stroke lifts nothing.
        """
        mean, row = self._model(stroke, tilt, ratio)
        p = self.parameters
        spread = float(row @ self._cov @ row) + p.height_model_std**2
        return Height(mean, math.sqrt(spread), float(row[1]) * p.stroke_tolerance)

    def stroke_for(self, height: float, tilt: float = 0.0, ratio: float = 1.0) -> float:
        """The stroke [m] that reaches a height [m] in the mean; tilt [rad] and ratio as above.

        Raises:
            ValueError: the height is not above 0.
        """
        if not (math.isfinite(height) and height > 0.0):
            raise ValueError(f"height = {height!r} m: must be finite and above 0 m")
        p = self.parameters
        weight = p.body2_mass * p.jump_gravity
        share = ratio * p.height_gain * self.gain * math.cos(tilt) ** 2
        work = height * 2.0 * p.jump_gravity * p.rover_mass**2 / (p.body2_mass * share)
        return (weight + math.sqrt(weight**2 + p.spring_rate * work)) / p.spring_rate - self.zero

    def learn(self, stroke: float, height: float, tilt: float = 0.0, ratio: float = 1.0) -> bool:
        """Learn from a jump that was flown; False if it is too far off to teach anything.

        Args:
            stroke: of the nut at the release [m].
            height: flown, as measured [m].
            tilt: of base_link z before the jump [rad].
            ratio: of the height to the formula's.
        """
        if not (math.isfinite(height) and height > 0.0) or stroke <= self.shortest_stroke:
            return False
        mean, row = self._model(stroke, tilt, ratio)
        p = self.parameters
        error = (p.height_measurement_std / mean) ** 2 + p.height_model_std**2
        error += (row[1] * p.stroke_tolerance) ** 2 / 3.0
        surprise = math.log(height / mean)
        spread = float(row @ self._cov @ row) + error
        if surprise**2 > _OUTLIER**2 * spread:
            return False
        gain = self._cov @ row / spread
        self._mean = self._mean + gain * surprise
        kept = np.eye(2) - np.outer(gain, row)
        self._cov = kept @ self._cov @ kept.T + error * np.outer(gain, gain)
        self.jumps += 1
        return True

    def draw(self, generator: np.random.Generator, count: int) -> NDArray[np.float64]:
        """Factors of the height and errors of the stroke [m] as they may truly be, (count, 2)."""
        p = self.parameters
        drawn = generator.multivariate_normal(self._mean, self._cov, count)
        drawn[:, 0] = np.exp(drawn[:, 0] + p.height_model_std * generator.standard_normal(count))
        drawn[:, 1] += p.stroke_tolerance * generator.uniform(-1.0, 1.0, count)
        return np.asarray(drawn)

    def same_as(self, stroke: float, gain: float, zero: float) -> float:
        """The stroke [m] by which a spring as of the parameters jumps as one that is off so does.

        Args:
            stroke: of the nut [m].
            gain: factor of the height.
            zero: error of the stroke [m].
        """
        p = self.parameters
        x, weight = stroke + zero, p.body2_mass * p.jump_gravity
        work = gain * (p.spring_rate * x**2 - 2.0 * weight * x)
        return (weight + math.sqrt(weight**2 + p.spring_rate * max(work, 0.0))) / p.spring_rate

    def formula(self, stroke: float, tilt: float = 0.0) -> float:
        """H [m] of the parameters alone, whatever was learnt.

        Raises:
            ValueError: the stroke lifts nothing.
        """
        return SpringEstimate(self.parameters).expected(stroke, tilt).mean

    def _model(self, stroke: float, tilt: float, ratio: float) -> tuple[float, NDArray[np.float64]]:
        """Mean height [m], and the derivatives of its logarithm by a and b."""
        p = self.parameters
        x, weight = stroke + self.zero, p.body2_mass * p.jump_gravity
        work = p.spring_rate * x**2 - 2.0 * weight * x
        if not work > 0.0:
            raise ValueError(
                f"stroke = {stroke!r} m: must be above {self.shortest_stroke:.4g} m to lift Body 2"
            )
        share = ratio * p.height_gain * self.gain * math.cos(tilt) ** 2
        mean = share * p.body2_mass * work / (2.0 * p.jump_gravity * p.rover_mass**2)
        return mean, np.array([1.0, (2.0 * p.spring_rate * x - 2.0 * weight) / work])
