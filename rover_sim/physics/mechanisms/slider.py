"""Body 2 on its slider: the force between the two bodies, with its tangents.

The slider coordinate s [m] is the distance from Body 1's centre of mass to Body 2's along the
slider axis (base_link +z); a positive force pushes the bodies apart (+z on Body 2, -z on Body 1).
It is the sum of

- the spring k (l0 - s) and the bearings' viscous and dry friction, -c s' - F s'/sqrt(s'^2 + v^2)
  (regularised, without stick: the nut holds Body 2 where it must be at rest);
- the end stops (`pad`): an upper one at s = l0, where Body 2 pulls Body 1 along after a jump, and a
  lower one below the stroke;
- the force of the jump drive's nut and latch, from `jump_drive.respond`.

All are internal forces, so the momentum of both bodies together is conserved.

A pad has the force k_p d max(0, 1 + a d') at the depth d > 0 (the damping law of Hunt and Crossley
1975, here with a linear stiffness): continuous at first contact, never adhesive, and the rebound
speed is at most 1/a.

Forces are means of a step. A pad's elastic part is the change of its energy over the change of its
depth (Gonzalez 1996, J. Nonlinear Science 6), so at any length of the step it stores what it does
not dissipate, and it dissipates at least zero. In a step in which s changes by D under the force F
of all these, the bodies gain F D, the elastic energy changes by dU (`slider_energy` before and
after), the nut's input is its work, and the remainder is heat of bearings, pads and a releasing
latch.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from msg_schemas.configuration import Configuration, quantity
from rover_sim.physics.numerics.compiled import checked_inner
from rover_sim.physics.numerics.named_parameters import from_parameters


@dataclass(frozen=True)
class SliderParameters(Configuration):
    """Jump spring between the bodies, slider bearing and end stops.

    Defaults: linear ball bearings with seals, whose friction takes 1.7 % of the energy of a 0.2 m
    jump and lets Body 2 come to rest on its spring within a few swings; the pads stop 2.4 kg (the
    reduced mass of 6 and 4 kg) from 2.8 m/s within 5 mm and 4 ms, which steps of 1 ms resolve.
    """

    spring_rate: float = quantity("N/m", "k of the jump spring", 824.0, above=0.0)
    free_length: float = quantity("m", "l0, between the centres of mass", 0.20, minimum=0.0)
    damping: float = quantity("N s/m", "of the bearing", 0.2, minimum=0.0)
    friction: float = quantity("N", "dry friction of the seals", 1.0, minimum=0.0)
    friction_rate: float = quantity(
        "m/s", "regularisation speed of the dry friction", 2.0e-3, above=0.0
    )
    lower_stop: float = quantity(
        "m", "compression at which the lower stop begins", 0.215, above=0.0
    )
    pad_stiffness: float = quantity("N/m", "stiffness of the end stops", 5.0e4, above=0.0)
    pad_damping: float = quantity("s/m", "damping of the end stops", 10.0, minimum=0.0)
    nut_stiffness: float = quantity("N/m", "of screw, nut and latch", 2.0e6, above=0.0)
    nut_damping: float = quantity("s/m", "of screw, nut and latch", 5.0, minimum=0.0)


class Slider(NamedTuple):
    """`SliderParameters` for compiled functions."""

    spring_rate: float
    free_length: float
    damping: float
    friction: float
    friction_rate: float
    lower_stop: float
    pad_stiffness: float
    pad_damping: float
    nut_stiffness: float
    nut_damping: float


class SliderForce(NamedTuple):
    """Mean force between the bodies in a step and its derivative."""

    force: float  # > 0 pushes the bodies apart [N]
    by_change: float  # d force / d (change of s) [N/m]


def make_slider(parameters: SliderParameters) -> Slider:
    """Convert the parameters for compiled functions."""
    return from_parameters(Slider, parameters)


@checked_inner
def pad(
    stiffness: float, damping: float, depth0: float, depth1: float, h: float
) -> tuple[float, float]:
    """Mean force of a pad in a step [N], and its derivative by the depth at the end [N/m].

    Args:
        stiffness: k_p [N/m].
        damping: a [s/m].
        depth0: at the step's start [m]; negative when apart.
        depth1: at its end [m].
        h: length of the step [s].
    """
    if depth0 <= 0.0 and depth1 <= 0.0:
        return 0.0, 0.0
    change = depth1 - depth0
    factor = 1.0 + damping * change / h
    if factor <= 0.0:
        return 0.0, 0.0
    if depth0 > 0.0 and depth1 > 0.0:
        elastic, slope = 0.5 * stiffness * (depth0 + depth1), 0.5 * stiffness
    elif depth1 > 0.0:
        elastic = 0.5 * stiffness * depth1 * depth1 / change
        slope = (stiffness * depth1 - elastic) / change
    else:
        elastic = -0.5 * stiffness * depth0 * depth0 / change
        slope = -elastic / change
    return elastic * factor, slope * factor + elastic * damping / h


@checked_inner
def slider_force(slider: Slider, s0: float, change: float, h: float) -> SliderForce:
    """Mean force of spring, bearings and end stops in a step.

    Args:
        slider: from `make_slider`.
        s0: distance of the bodies' centres along the slider at the step's start [m].
        change: of that distance in the step [m].
        h: length of the step [s].
    """
    rate = change / h
    compression0 = slider.free_length - s0
    compression1 = compression0 - change
    soft = math.sqrt(rate * rate + slider.friction_rate * slider.friction_rate)
    dry = slider.friction / soft
    force = slider.spring_rate * 0.5 * (compression0 + compression1)
    force -= (slider.damping + dry) * rate
    by_change = -0.5 * slider.spring_rate
    by_change -= (slider.damping + dry * (slider.friction_rate / soft) ** 2) / h
    upper, upper_slope = pad(
        slider.pad_stiffness, slider.pad_damping, -compression0, -compression1, h
    )
    lower, lower_slope = pad(
        slider.pad_stiffness,
        slider.pad_damping,
        compression0 - slider.lower_stop,
        compression1 - slider.lower_stop,
        h,
    )
    return SliderForce(force - upper + lower, by_change - upper_slope - lower_slope)


@checked_inner
def slider_energy(slider: Slider, pressing: bool, nut_position: float, s: float) -> float:
    """Elastic energy [J] of spring, pads and, if `pressing`, the nut at `nut_position`."""
    compression = slider.free_length - s
    energy = 0.5 * slider.spring_rate * compression * compression
    depth = max(-compression, compression - slider.lower_stop, 0.0)
    energy += 0.5 * slider.pad_stiffness * depth * depth
    if pressing:
        depth = max(nut_position - compression, 0.0)
        energy += 0.5 * slider.nut_stiffness * depth * depth
    return energy
