"""Plot of the wall area covered by a descent's images."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from msg_schemas import machine
from rover_bags.analysis.wall_coverage import (
    VIEW_HEIGHT,
    VIEW_WIDTH,
    Observations,
    wall_distances,
)
from rover_bags.views.plots import BLUE, ORANGE

GREY: Final = "#868e96"


def draw_coverage(seen: Observations) -> Figure | None:
    """Draw the image footprints on the unrolled wall, depth downward; None without images."""
    if not len(seen.depth):
        return None
    figure = Figure(figsize=(11.4, 5.0))
    figure.set_label("coverage")
    axes = figure.add_axes((0.065, 0.12, 0.92, 0.74))
    known = np.isfinite(seen.smear)
    sharp = known & (np.nan_to_num(seen.smear) <= machine.SHARP_SMEAR)
    distance = wall_distances(seen)
    half = distance * math.tan(0.5 * VIEW_HEIGHT)
    width = math.degrees(VIEW_WIDTH)
    heading = np.degrees(np.remainder(seen.heading + math.pi, 2.0 * math.pi) - math.pi)
    marks = []
    for chosen, colour, name in (
        (sharp, BLUE, f"sharp (at most {machine.SHARP_SMEAR:.2g} px)"),
        (known & ~sharp, ORANGE, "smeared"),
        (~known, GREY, "of unknown smear"),
    ):
        if not chosen.any():
            continue
        # Footprints wrap around at the edges of the map.
        boxes = [
            Rectangle(
                (heading[at] - 0.5 * width + turn, seen.depth[at] - half[at]), width, 2.0 * half[at]
            )
            for at in np.flatnonzero(chosen)
            for turn in (-360.0, 0.0, 360.0)
            if abs(heading[at] + turn) < 180.0 + 0.5 * width
        ]
        axes.add_collection(
            PatchCollection(boxes, facecolor=colour, edgecolor=colour, alpha=0.35, linewidth=0.8)
        )
        axes.plot(heading[chosen], seen.depth[chosen], "o", color=colour, ms=3.5, mew=0.0)
        label = f"{int(chosen.sum())} {name}"
        marks.append(Line2D([], [], marker="s", ls="", color=colour, alpha=0.6, label=label))
    axes.set_xlim(-180.0, 180.0)
    axes.set_xticks(range(-180, 181, 30))
    low, high = float(np.min(seen.depth - half)), float(np.max(seen.depth + half))
    margin = 0.05 * (high - low)
    axes.set_ylim(high + margin, low - margin)
    axes.set_xlabel("heading relative to the start [deg]")
    axes.set_ylabel("depth [m]")
    axes.set_title("Wall coverage of the images", pad=26, loc="left", x=-0.055)
    axes.legend(
        handles=marks, loc="lower left", bbox_to_anchor=(-0.02, 0.985), ncol=3,
        handletextpad=0.3, columnspacing=1.4, borderaxespad=0.0,
    )  # fmt: skip
    return figure
