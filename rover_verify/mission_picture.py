"""One picture of a whole mission, several moments in each view: what the suite simulates.

The mission is that of `rover_verify.scripted_mission`, flown when the picture is made:

    mother_rover picture docs/mission.png
"""

from __future__ import annotations

import argparse
import itertools
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from rover_sim import SpatialPlant, SpatialState, StepResult
from rover_verify.scripted_mission import TICK, Mission, fly, make_plant

Array = NDArray[np.float64]

_BODY1, _BODY2, _TETHER, _GROUND, _WHEEL = "#0072b2", "#d55e00", "#4d4d4d", "#b8ae9e", "#1a1a1a"
_DOWN_EVERY = 4.0  # [s]
_WHOLE, _FAINT = 1.0, 0.35  # opacity
_SMOOTH = 12  # points of each element of the tether


@dataclass
class Moments:
    """States of a mission as it is flown, one in ten."""

    states: list[SpatialState] = field(default_factory=list)

    def watch(self, state: SpatialState, _result: StepResult) -> None:
        """Keep it, if it is one of those."""
        if round(state.time / TICK) % 10 == 0:
            self.states.append(state)

    def within(self, mission: Mission, name: str) -> list[SpatialState]:
        """Those of a leg; of legs of the same name, of the first."""
        leg = next(leg for leg in mission.legs if leg.name == name)
        return [state for state in self.states if leg.begin < state.time <= leg.end]


def draw(mission: Mission, moments: Moments) -> Figure:
    """Three views from the side: the way down, a drive and a jump."""
    plant = mission.plant
    floor = plant.scenario.environment.floor_height
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    down, drive, jump = figure.subplots(1, 3, width_ratios=(1.0, 1.45, 1.45))
    for axes in (down, drive, jump):
        for line in plant.scenario.environment.outline():
            axes.fill_between(line[:, 0], line[:, 1], -99.0, color=_GROUND, linewidth=0.0)
        axes.set_aspect("equal")
        axes.set(xlabel="x [m]")
        axes.spines[["top", "right"]].set_visible(False)

    down.plot(0.0, 0.0, "s", color=_WHEEL, markersize=7)
    lowered = moments.within(mission, "lower")
    for state in lowered[:: round(_DOWN_EVERY / (10 * TICK))]:
        _rover(down, plant, state, _WHOLE)
    down.set(xlim=(-1.9, 1.9), ylim=(floor - 0.5, 0.5), ylabel="z [m]")
    down.set_title("lowered by the winch", fontsize=10)

    driven = moments.within(mission, "drive straight")
    _rover(drive, plant, driven[0], _FAINT)
    _rover(drive, plant, driven[-1], _WHOLE)
    drive.set_title("drives, on slack tether", fontsize=10)
    flown = moments.within(mission, "take off and land")
    _rover(jump, plant, flown[0], _FAINT)
    _rover(jump, plant, max(flown, key=lambda state: float(state.G1[2])), _WHOLE)
    jump.set_title("turns, and jumps", fontsize=10)
    for axes in (drive, jump):
        axes.set(xlim=(-1.1, 1.5), ylim=(floor - 0.25, floor + 2.0))
    return figure


def _rover(axes: Axes, plant: SpatialPlant, state: SpatialState, strength: float) -> None:
    """Tether, bodies and wheels as they stand at a moment, seen along y."""
    rover = plant.scenario.rover
    assert rover is not None
    nodes = plant.to_full_nodes(state)
    lengths = np.diff(plant.to_arc_lengths(state))
    pieces = zip(nodes[:-1], nodes[1:], lengths, strict=True)
    line = np.concatenate([_curve(*piece) for piece in pieces])
    axes.plot(line[:, 0], line[:, 2], color=_TETHER, linewidth=1.0, alpha=strength, zorder=3)
    turned = state.rotation
    for centre, size, colour in (
        (state.G1 + turned @ np.array(rover.body1_centre), rover.body1_size, _BODY1),
        (state.G2, rover.body2_size, _BODY2),
    ):
        corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * np.array(size)
        seen = (centre + corners @ turned.T)[:, [0, 2]]
        hull = seen[ConvexHull(seen).vertices]
        axes.add_patch(Polygon(hull, facecolor=colour, alpha=strength, zorder=4))
    angles = np.linspace(0.0, 2.0 * np.pi, 49)[:, None]
    rim = np.hstack([np.cos(angles), 0.0 * angles, np.sin(angles)]) * rover.wheels.radius
    for place in (rover.wheels.left, rover.wheels.right):
        seen = state.G1 + (rim + np.array(place)) @ turned.T
        axes.plot(seen[:, 0], seen[:, 2], color=_WHEEL, linewidth=1.2, alpha=strength, zorder=5)


def _curve(one: Array, two: Array, length: float) -> Array:
    """Points of an element between two nodes with their slopes, (k, 3)."""
    x = np.linspace(0.0, 1.0, _SMOOTH)[:, None]
    shapes = (1 - 3 * x**2 + 2 * x**3, x - 2 * x**2 + x**3, 3 * x**2 - 2 * x**3, x**3 - x**2)
    values = (one[0], length * one[1], two[0], length * two[1])
    found: Array = sum(
        (shape * value for shape, value in zip(shapes, values, strict=True)), 0.0 * x
    )
    return found


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = (
        "Simulate a scripted mission and draw it as one picture, several instants in each view."
    )
    parser.add_argument("picture", type=Path, help="file to write, .png")
    parser.add_argument("--seed", type=int, default=3, help="seed of relief and boulders")


def run(options: argparse.Namespace) -> int:
    """Simulate the mission and write its picture."""
    moments = Moments()
    mission = Mission(make_plant(options.seed), moments.watch)
    fly(mission)
    figure = draw(mission, moments)
    FigureCanvasAgg(figure).print_figure(str(options.picture), dpi=100, metadata={"Software": None})
    print(f"wrote {options.picture}")
    return 0
