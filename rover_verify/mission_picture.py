"""Figure of a whole mission, with several instants in each view.

The mission is that of `rover_verify.scripted_mission`, simulated when the figure is drawn:

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
_OPAQUE, _FAINT = 1.0, 0.35  # opacity
_POINTS = 12  # points per tether element


@dataclass
class Snapshots:
    """Every tenth state of a simulated mission."""

    states: list[SpatialState] = field(default_factory=list)

    def watch(self, state: SpatialState, _result: StepResult) -> None:
        """Store every tenth state."""
        if round(state.time / TICK) % 10 == 0:
            self.states.append(state)

    def within(self, mission: Mission, name: str) -> list[SpatialState]:
        """States of the first leg with this name."""
        leg = next(leg for leg in mission.legs if leg.name == name)
        return [state for state in self.states if leg.begin < state.time <= leg.end]


def draw(mission: Mission, snapshots: Snapshots) -> Figure:
    """Three side views: descent, drive and jump."""
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
    lowered = snapshots.within(mission, "lower")
    for state in lowered[:: round(_DOWN_EVERY / (10 * TICK))]:
        _rover(down, plant, state, _OPAQUE)
    down.set(xlim=(-1.9, 1.9), ylim=(floor - 0.5, 0.5), ylabel="z [m]")
    down.set_title("lowered by the winch", fontsize=10)

    driven = snapshots.within(mission, "drive straight")
    _rover(drive, plant, driven[0], _FAINT)
    _rover(drive, plant, driven[-1], _OPAQUE)
    drive.set_title("drives on a slack tether", fontsize=10)
    flown = snapshots.within(mission, "take off and land")
    _rover(jump, plant, flown[0], _FAINT)
    _rover(jump, plant, max(flown, key=lambda state: float(state.G1[2])), _OPAQUE)
    jump.set_title("turns and jumps", fontsize=10)
    for axes in (drive, jump):
        axes.set(xlim=(-1.1, 1.5), ylim=(floor - 0.25, floor + 2.0))
    return figure


def _rover(axes: Axes, plant: SpatialPlant, state: SpatialState, opacity: float) -> None:
    """Draw tether, bodies and wheels of one state, seen along y."""
    rover = plant.scenario.rover
    assert rover is not None
    nodes = plant.to_full_nodes(state)
    lengths = np.diff(plant.to_arc_lengths(state))
    elements = zip(nodes[:-1], nodes[1:], lengths, strict=True)
    line = np.concatenate([_curve(*element) for element in elements])
    axes.plot(line[:, 0], line[:, 2], color=_TETHER, linewidth=1.0, alpha=opacity, zorder=3)
    rotation = state.rotation
    for centre, size, colour in (
        (state.G1 + rotation @ np.array(rover.body1_centre), rover.body1_size, _BODY1),
        (state.G2, rover.body2_size, _BODY2),
    ):
        corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * np.array(size)
        projected = (centre + corners @ rotation.T)[:, [0, 2]]
        hull = projected[ConvexHull(projected).vertices]
        axes.add_patch(Polygon(hull, facecolor=colour, alpha=opacity, zorder=4))
    angles = np.linspace(0.0, 2.0 * np.pi, 49)[:, None]
    circle = np.hstack([np.cos(angles), 0.0 * angles, np.sin(angles)]) * rover.wheels.radius
    for place in (rover.wheels.left, rover.wheels.right):
        projected = state.G1 + (circle + np.array(place)) @ rotation.T
        axes.plot(
            projected[:, 0], projected[:, 2], color=_WHEEL, linewidth=1.2, alpha=opacity, zorder=5
        )


def _curve(start: Array, end: Array, length: float) -> Array:
    """Points (k, 3) of an element between two nodes with their slopes."""
    x = np.linspace(0.0, 1.0, _POINTS)[:, None]
    shapes = (1 - 3 * x**2 + 2 * x**3, x - 2 * x**2 + x**3, 3 * x**2 - 2 * x**3, x**3 - x**2)
    values = (start[0], length * start[1], end[0], length * end[1])
    points: Array = sum(
        (shape * value for shape, value in zip(shapes, values, strict=True)), 0.0 * x
    )
    return points


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = (
        "Simulate a scripted mission and draw it as one picture, several instants in each view."
    )
    parser.add_argument("picture", type=Path, help="file to write, .png")
    parser.add_argument("--seed", type=int, default=3, help="seed of relief and boulders")


def run(options: argparse.Namespace) -> int:
    """Simulate the mission and write its picture."""
    snapshots = Snapshots()
    mission = Mission(make_plant(options.seed), snapshots.watch)
    fly(mission)
    figure = draw(mission, snapshots)
    FigureCanvasAgg(figure).print_figure(str(options.picture), dpi=100, metadata={"Software": None})
    print(f"wrote {options.picture}")
    return 0
