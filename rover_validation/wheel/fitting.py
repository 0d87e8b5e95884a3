"""Identification of a soil by least squares, and predictions with bands."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import norm

from msg_schemas.fields import shown
from rover_estimation import inverse_curvature, minimise
from rover_sim import STEEPEST_WHEEL, Soil, Wheel, steady_wheel, wheel_on_soil
from rover_validation.refusals import SetError
from rover_validation.wheel.sets import IdentifiedSoil, Indentation, Runs

Array = NDArray[np.float64]

SCALES: Final = (1.0, 1.0, 2.0e-3)
"""Errors of equal weight: forward force, sideways force [N], sinkage [m]."""
BAND: Final = 0.9
CONFIDENCE: Final = 0.95
_BOUNDS: Final[Mapping[str, tuple[float, float]]] = {
    "friction_angle": (5.0, 50.0),
    "shear_modulus": (1.0e-4, 0.1),
    "slip_weakening": (0.0, 10.0),
    "side_weakening": (0.0, 10.0),
    "slip_saturation": (0.05, 5.0),
    "ploughing": (0.0, 1.0e7),
    "front_ploughing": (0.0, 20.0),
    "ploughing_decay": (0.0, 10.0),
    "shear_release": (0.05, 10.0),
    "rear_contact": (0.0, 1.0),
    "excavation": (0.0, 3.0),
    "grouser_thrust": (0.0, 10.0),
}
_START: Final[Mapping[str, float]] = {
    "friction_angle": 26.0,
    "shear_modulus": 0.01,
    "slip_weakening": 2.0,
    "side_weakening": 1.8,
    "slip_saturation": 0.5,
    "ploughing": 3.0e5,
    "front_ploughing": 3.0,
    "ploughing_decay": 1.0,
    "shear_release": 1.5,
    "rear_contact": 0.25,
    "excavation": 0.3,
    "grouser_thrust": 2.0,
}
_OF_GROUSERS: Final = ("excavation", "grouser_thrust")
NUMBER_UNITS: Final[Mapping[str, str]] = {
    "friction_angle": "deg",
    "shear_modulus": "m",
    "ploughing": "N/m^3",
}
"""Units of identified numbers; the others have none."""
_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(24)


@dataclass(frozen=True)
class SoilIdentification:
    """A fit: the soil, intervals of its numbers, residuals.

    Attributes:
        found: the soil as written.
        interval: 95 % interval of each identified number.
        remarks: what is no soil's number, by name.
        residuals: predicted less measured: forward, sideways [N], sinkage [m], (k, 3).
    """

    found: IdentifiedSoil
    interval: dict[str, tuple[float, float]]
    remarks: dict[str, str]
    residuals: Array


def predict(soil: Soil, wheels: Mapping[str, Wheel], runs: Runs) -> Array:
    """Forward force [N], sideways force against the travel [N] and sinkage [m] of runs, (k, 3).

    A load that the soil does not carry has the forces and the sinkage of a buried wheel.
    """
    systems = {name: wheel_on_soil(wheel, soil) for name, wheel in wheels.items()}
    found = np.empty((len(runs.wheel), 3))
    for i, name in enumerate(runs.wheel):
        system = systems[name]
        forward = max(runs.travel[i] * math.cos(runs.angle[i]), 0.0)
        side = runs.travel[i] * math.sin(runs.angle[i])
        rim = runs.rim[i] * system.shear_radius / system.radius
        sinkage, pull, across, _ = steady_wheel(system, runs.load[i], forward, side, rim)
        found[i] = pull, across, sinkage
    return found


def check_wheels(wheels: Mapping[str, Wheel], runs: Runs, source: str) -> None:
    """Refuse runs of a wheel that is not described.

    Raises:
        SetError: naming line and wheel.
    """
    for i, name in enumerate(runs.wheel):
        if name not in wheels:
            raise SetError(
                f"{source}, run {i + 1}: wheel = {shown(name)}: "
                f"should be one of {', '.join(wheels)}"
            )


def plate_law(indentation: Indentation) -> tuple[float, float, float]:
    """k_c [N/m^(n+1)], k_phi [N/m^(n+2)] and n of the pressure k_c/b + k_phi times z^n.

    Standing wheels, which have the size that matters, go before plates: k_phi and n then, with
    k_c = 0, from the smooth ones if there are any, up to half the radius. The pressure under plates
    gives all three, with b the diameter.
    """
    smooth = [w for w in indentation.standing if indentation.wheels[w[0]].grouser_height == 0.0]
    standing = smooth or list(indentation.standing)
    if standing:
        curves = [
            (
                indentation.wheels[name],
                z,
                force,
                (z > 0.0) & (z <= 0.5 * indentation.wheels[name].radius),
            )
            for name, z, force in standing
        ]

        def misfit(x: Array) -> Array:
            return np.concatenate(
                [
                    _standing_force(wheel, z[near], math.exp(x[0]), x[1]) - force[near]
                    for wheel, z, force, near in curves
                ]
            )

        fit = least_squares(misfit, [math.log(1.0e6), 1.0], bounds=([0.0, 0.3], [40.0, 2.0]))
        return 0.0, math.exp(fit.x[0]), float(fit.x[1])
    size = np.concatenate([np.full(z.size, d) for d, z, _ in indentation.plates])
    depth = np.concatenate([z for _, z, _ in indentation.plates])
    pressure = np.concatenate([f / (0.25 * math.pi * d * d) for d, _, f in indentation.plates])

    def plates(x: Array) -> Array:
        law = (x[0] * 1e4 / size + x[1] * 1e6) * depth ** x[2]
        return np.asarray((law - pressure) / np.mean(pressure))

    fit = least_squares(plates, [0.0, 1.0, 1.0], bounds=([0.0, 1e-6, 0.3], [1e3, 1e3, 2.0]))
    return float(fit.x[0] * 1e4), float(fit.x[1] * 1e6), float(fit.x[2])


def _standing_force(wheel: Wheel, z: Array, modulus: float, exponent: float) -> Array:
    entry = np.arccos(1.0 - z / wheel.radius)[:, None]
    theta = 0.5 * entry * (1.0 + _POINTS)
    depth = wheel.radius * (np.cos(theta) - 1.0) + z[:, None]
    pressure = modulus * np.maximum(depth, 0.0) ** exponent
    force: Array = (pressure * np.cos(theta) * 0.5 * entry * _WEIGHTS).sum(axis=1)
    return 2.0 * wheel.width * wheel.radius * force


def identify(runs: Runs, indentation: Indentation) -> SoilIdentification:
    """Identify the soil of measured runs; dry sand, c = 0.

    Raises:
        SetError: a wheel is not described, or the runs are fewer than the numbers.
    """
    wheels = indentation.wheels
    check_wheels(wheels, runs, "measured runs")
    names = tuple(
        name
        for name in _START
        if name not in _OF_GROUSERS or any(wheels[w].grouser_height > 0.0 for w in set(runs.wheel))
    )
    settings = len(set(runs.settings()))
    if 3 * settings < 2 * len(names):
        raise SetError(f"{settings} settings: should be at least {math.ceil(2 * len(names) / 3)}")
    k_c, k_phi, n = plate_law(indentation)
    base = Soil(cohesive_modulus=k_c, frictional_modulus=k_phi, exponent=n, cohesion=0.0)
    start = np.array([_START[name] for name in names])
    low, high = np.array([_BOUNDS[name] for name in names]).T

    def soil_at(x: Array) -> Soil:
        return replace(base, **dict(zip(names, (x * start).tolist(), strict=True)))

    def misfit(x: Array) -> Array:
        found = predict(soil_at(x), wheels, runs)
        return ((found - runs.measured) / SCALES).ravel()

    fit = minimise(
        misfit,
        np.ones(len(names)),
        np.ones(len(names)),
        bounds=(low / start, high / start),
        difference=1e-4,
        evaluations=60,
        tolerance=1e-6,
    )
    soil = soil_at(fit.x)
    residuals = predict(soil, wheels, runs) - runs.measured
    covariance = _covariance(fit.jacobian, fit.residuals, settings / len(runs.wheel))
    covariance *= np.outer(start, start)
    deviation = np.sqrt(np.diag(covariance)) * norm.ppf(0.5 + 0.5 * CONFIDENCE)
    values = fit.x * start
    interval = {
        name: (max(values[i] - deviation[i], low[i]), min(values[i] + deviation[i], high[i]))
        for i, name in enumerate(names)
    }
    scatter = np.sqrt(np.mean(residuals**2, axis=0))
    return SoilIdentification(
        IdentifiedSoil(soil, wheels, names, covariance, (scatter[0], scatter[1], scatter[2]), {}),
        interval,
        _remarks(soil, names, interval, indentation),
        residuals,
    )


def _covariance(jacobian: Array, residuals: Array, independent: float) -> Array:
    """Covariance of a fit whose residuals stem from the law: repeats count as one setting."""
    variance = float(residuals @ residuals) / max(
        independent * residuals.size - jacobian.shape[1], 1.0
    )
    return np.asarray(variance * inverse_curvature(jacobian))


def _remarks(
    soil: Soil,
    names: tuple[str, ...],
    interval: Mapping[str, tuple[float, float]],
    indentation: Indentation,
) -> dict[str, str]:
    """Return a remark on each identified number that is no property of a soil."""
    remarks: dict[str, str] = {}
    for name in names:
        value, (low, high) = getattr(soil, name), _BOUNDS[name]
        width = interval[name][1] - interval[name][0]
        if min(value - low, high - value) < 1e-3 * (high - low) and value > 0.0:
            remarks[name] = f"at its bound, {low:g} to {high:g}: not determined"
        elif width > 2.0 * abs(value):
            remarks[name] = "interval wider than the number: hardly determined"
    weight, repose = indentation.weight, indentation.repose
    if math.isfinite(repose) and abs(soil.friction_angle - repose) > 5.0:
        remarks.setdefault(
            "friction_angle", f"{soil.friction_angle - repose:+.0f} deg from the angle of repose"
        )
    if math.isfinite(weight) and "ploughing" not in remarks:
        rankine = math.tan(math.radians(45.0 + 0.5 * soil.friction_angle)) ** 2
        times = soil.ploughing / (weight * rankine)
        remarks["ploughing"] = (
            f"{times:.1f} times Rankine's passive pressure of a long wall: holds for this width"
        )
    for name, why in (
        ("front_ploughing", "no soil's number: what the pressure on a curved rim differs by"),
        ("slip_weakening", "no soil's number: holds for this sand's packing and this wheel's size"),
        ("side_weakening", "no soil's number: holds for this sand's packing and this wheel's size"),
        ("excavation", "of the grousers' form, not of the soil"),
        ("grouser_thrust", "of the grousers' form and spacing, not of the soil"),
    ):
        if name in names:
            remarks.setdefault(name, why)
    return remarks


def bands(found: IdentifiedSoil, runs: Runs) -> tuple[Array, Array]:
    """Predictions and half widths of their 90 % bands, (k, 3) each.

    The bands hold the residuals of the identification and the uncertainty of its numbers.
    """
    centre = predict(found.soil, found.wheels, runs)
    slopes = np.empty((centre.size, len(found.names)))
    for j, name in enumerate(found.names):
        value = getattr(found.soil, name)
        step = max(1e-3 * abs(value), 1e-6)
        changed = predict(replace(found.soil, **{name: value + step}), found.wheels, runs)
        slopes[:, j] = ((changed - centre) / step).ravel()
    variance = np.einsum("ij,jk,ik->i", slopes, found.covariance, slopes).reshape(centre.shape)
    half = norm.ppf(0.5 + 0.5 * BAND) * np.sqrt(np.array(found.scatter) ** 2 + variance)
    return centre, np.asarray(half)


def within_validity(runs: Runs) -> NDArray[np.bool_]:
    """Whether the law holds for the angle of each run, (k,)."""
    return np.asarray(np.degrees(runs.angle) <= STEEPEST_WHEEL + 1e-6)
