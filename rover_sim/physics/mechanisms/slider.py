"""Body 2 on its slider: the force between the two bodies, with its tangents.

The slider coordinate s [m] is the distance from Body 1's centre of mass to Body 2's along the
slider axis (base_link +z); a positive force pushes the bodies apart (+z on Body 2, -z on Body 1).
It is the sum of

- the spring k (l0 - s) and the bearings' viscous and dry friction, -c s' - F s'/sqrt(s'^2 + v^2)
  (regularised, without stick: the nut holds Body 2 where it must be at rest);
- the end stops: an upper one at s = l0, where Body 2 pulls Body 1 along after a jump, and a lower
  one below the stroke. Both are pads with f = k_p d max(0, 1 + a d') at the depth d > 0 (the
  damping law of Hunt and Crossley 1975, here with a linear stiffness): the force is continuous at
  first contact, never adhesive, and the rebound speed is at most 1/a;
- the force of the jump drive's nut (`NutAction`): it presses on the latch, one-sided, by the same
  law with the stiffness of screw and nut; a releasing latch holds Body 2 with a force that falls to
  zero; a nut that moves up past the latch lifts Body 2 with a small force.

All are internal forces, so the momentum of both bodies together is conserved.

Energy of a step in which s grows by D under the force F: the bodies gain F D, the elastic energy
changes by dU (`slider_energy` before and after), the nut's input is `nut_work`, and the remainder,
nut_work - F D - dU, is heat of bearings, pads and a releasing latch.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from rover_sim.physics.numerics.compiled import checked_inner
from rover_sim.physics.numerics.parameter_ranges import check_ranges


@dataclass(frozen=True)
class SliderParameters:
    """Spring, slider bearing and end stops.

    Defaults: linear ball bearings with seals, whose friction takes 1.7 % of the energy of a 0.2 m
    jump and lets Body 2 come to rest on its spring within a few swings; the pads stop 2.4 kg (the
    reduced mass of 6 and 4 kg) from 2.8 m/s within 5 mm and 4 ms, which steps of 1 ms resolve.

    Raises:
        ValueError: a value is not finite or out of its range.
    """

    spring_rate: float = 824.0  # k [N/m]
    free_length: float = 0.20  # l0, s with the spring relaxed: the upper stop [m]
    damping: float = 0.2  # c [N s/m]
    friction: float = 1.0  # F [N]
    friction_rate: float = 2.0e-3  # v, regularisation speed of F [m/s]
    lower_stop: float = 0.215  # compression at which the lower stop begins [m]
    pad_stiffness: float = 5.0e4  # k_p of the end stops [N/m]
    pad_damping: float = 10.0  # a of the end stops [s/m]
    nut_stiffness: float = 2.0e6  # of screw, nut and latch [N/m]
    nut_damping: float = 5.0  # a of screw, nut and latch [s/m]

    def __post_init__(self) -> None:
        check_ranges(
            self,
            positive=(
                "spring_rate",
                "friction_rate",
                "lower_stop",
                "pad_stiffness",
                "nut_stiffness",
            ),
            not_negative=("free_length", "damping", "friction", "pad_damping", "nut_damping"),
        )


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


class NutAction(NamedTuple):
    """Action of the nut on Body 2 in one step of the plant."""

    pressing: bool  # whether nut and latch can touch
    position: float  # of the nut at mid-step [m of compression]
    rate: float  # mean [m/s], > 0 compresses
    holding_force: float  # of a releasing latch, pushes Body 2 down [N]
    lifting_force: float  # of a nut that moves up past the latch, pushes Body 2 up [N]


class SliderForce(NamedTuple):
    """Force between the bodies and its tangents."""

    force: float  # > 0 pushes the bodies apart [N]
    by_position: float  # d force / d s [N/m]
    by_rate: float  # d force / d s' [N s/m]
    nut_force: float  # of the nut on Body 2, > 0 compresses; part of `force` [N]


def make_slider(parameters: SliderParameters) -> Slider:
    """Convert the parameters to plain floats for compiled functions."""
    return Slider(*(float(getattr(parameters, name)) for name in Slider._fields))


@checked_inner
def pad(stiffness: float, damping: float, depth: float, rate: float) -> tuple[float, float, float]:
    """Force of a one-sided contact, k d max(0, 1 + a d'), and its derivatives by d and d'."""
    if depth <= 0.0:
        return 0.0, 0.0, 0.0
    factor = 1.0 + damping * rate
    if factor <= 0.0:
        return 0.0, 0.0, 0.0
    return stiffness * depth * factor, stiffness * factor, stiffness * depth * damping


@checked_inner
def nut_force(slider: Slider, nut: NutAction, s: float, s_rate: float) -> float:
    """Force [N] of the nut on Body 2, > 0 compresses the spring."""
    force = nut.holding_force - nut.lifting_force
    if nut.pressing:
        depth = nut.position - slider.free_length + s
        force += pad(slider.nut_stiffness, slider.nut_damping, depth, nut.rate + s_rate)[0]
    return force


@checked_inner
def slider_force(slider: Slider, nut: NutAction, s: float, s_rate: float) -> SliderForce:
    """Force between the bodies at (s, s') with its tangents.

    Args:
        slider: from `make_slider`.
        nut: of this step, from the jump drive's outputs.
        s: distance of the bodies' centres along the slider [m].
        s_rate: its rate [m/s].
    """
    compression = slider.free_length - s
    soft = math.sqrt(s_rate * s_rate + slider.friction_rate * slider.friction_rate)
    dry = slider.friction / soft
    force = slider.spring_rate * compression - (slider.damping + dry) * s_rate
    by_position = -slider.spring_rate
    by_rate = -slider.damping - dry * (slider.friction_rate / soft) ** 2
    if compression < 0.0:
        f, k, c = pad(slider.pad_stiffness, slider.pad_damping, -compression, s_rate)
        force, by_position, by_rate = force - f, by_position - k, by_rate - c
    elif compression > slider.lower_stop:
        depth = compression - slider.lower_stop
        f, k, c = pad(slider.pad_stiffness, slider.pad_damping, depth, -s_rate)
        force, by_position, by_rate = force + f, by_position - k, by_rate - c
    on_body2 = nut.holding_force - nut.lifting_force
    if nut.pressing:
        depth = nut.position - compression
        f, k, c = pad(slider.nut_stiffness, slider.nut_damping, depth, nut.rate + s_rate)
        on_body2, by_position, by_rate = on_body2 + f, by_position - k, by_rate - c
    return SliderForce(force - on_body2, by_position, by_rate, on_body2)


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
