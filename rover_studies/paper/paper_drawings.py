"""Plots of the paper's study as SVG for embedding in a page."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Iterable, Sequence
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from rover_studies.paper.paper_claims import keys_of
from rover_studies.paper.paper_curves import SCATTER, Convergence, Curve, Curves
from rover_studies.paper.paper_plan import (
    CASES,
    GEOMETRIES,
    HEIGHT,
    RELAXED,
    SHAPES,
    THRESHOLD,
    UNRELAXED,
    PaperFigure,
)

_MESH_COLOURS: Final = ("#d55e00", "#e69f00", "#56b4e9", "#08306b", "#009e73", "#cc79a7")
_CASE_COLOURS: Final = ("#0072b2", "#009e73", "#cc79a7")
_MARKS: Final = ("o", "s", "^", "D", "v", "P")
_SHAPE_WORDS: Final = {RELAXED: "in static equilibrium", UNRELAXED: "unrelaxed catenary"}
_STYLE: Final[Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "mother_rover",
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "axes.edgecolor": "#868e96",
    "axes.grid": True,
    "grid.color": "#e9ecef",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "lines.linewidth": 1.4,
    "lines.markersize": 3.6,
}
_LABELS: Final = {True: "jump height [m]", False: "attitude variation [rad]"}
_LEAST_RESPONSE: Final = 1e-8


def _svg(figure: Figure) -> str:
    stream = io.StringIO()
    FigureCanvasSVG(figure).print_svg(stream, metadata={"Date": None})
    text = stream.getvalue()
    body = re.sub(r"<metadata>.*?</metadata>", "", text[text.index("<svg") :], flags=re.DOTALL)
    # The drawing uses the width and fonts of the page.
    body = re.sub(r'<svg([^>]*?) width="[^"]*"', r"<svg\1", body, count=1)
    body = re.sub(r'<svg([^>]*?) height="[^"]*"', r"<svg\1", body, count=1)
    return body.replace("'DejaVu Sans'", "system-ui, 'DejaVu Sans', sans-serif")


def _named(svg: str, name: str) -> str:
    """Prefix the identifiers of a drawing, to make them unique within the page."""
    for mark in ('id="', 'href="#', "url(#"):
        svg = svg.replace(mark, f"{mark}{name}-")
    return svg


def _threshold(axes: Axes) -> None:
    axes.axvline(THRESHOLD, color="#868e96", linewidth=1.0, linestyle=(0, (4, 3)), zorder=0)


def _draw(axes: Axes, curve: Curve, height: bool, colour: str, mark: str, label: str) -> None:
    values = curve.height if height else curve.turn
    axes.plot(curve.slack, values, color=colour, alpha=0.55, linewidth=1.0)
    axes.plot(curve.slack, values, mark, color=colour, label=label, markeredgewidth=0.0)


def paper_figure(figure: PaperFigure, curves: Curves) -> list[str]:
    """Draw a figure of the paper over slack for each geometry, once for each initial shape.

    A figure of several cases has the coarsest and the finest mesh, the others have all meshes.
    """
    return [_panels(figure, curves, shape) for shape in SHAPES]


def _panels(paper: PaperFigure, curves: Curves, shape: str) -> str:
    several = len(paper.cases) > 1
    meshes = sorted({key.elements for key in curves if key.case in paper.cases})
    rows: list[tuple[str, tuple[int, ...]]]
    if several:
        ends = dict.fromkeys((meshes[0], meshes[-1]))
        rows = [(quantity, (mesh,)) for quantity in paper.quantities for mesh in ends]
    else:
        rows = [(quantity, tuple(meshes)) for quantity in paper.quantities]
    geometries = [g for g in GEOMETRIES if any(key.geometry == g for key in curves)]
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(11.4, 2.35 * len(rows) + 0.9), layout="constrained")
        grid = figure.subplots(len(rows), len(geometries), sharex=True, sharey="row", squeeze=False)
        for (quantity, shown), line in zip(rows, grid, strict=True):
            for geometry, axes in zip(geometries, line, strict=True):
                _threshold(axes)
                for number, case in enumerate(paper.cases):
                    for key in keys_of(curves, case, geometry, shape):
                        if key.elements not in shown:
                            continue
                        place = number if several else meshes.index(key.elements)
                        colours = _CASE_COLOURS if several else _MESH_COLOURS
                        _draw(
                            axes,
                            curves[key],
                            quantity == HEIGHT,
                            colours[place % len(colours)],
                            _MARKS[place % len(_MARKS)],
                            CASES[case].label if several else f"n = {key.elements}",
                        )
            mesh = f", n = {shown[0]}" if several else ""
            line[0].set_ylabel(_LABELS[quantity == HEIGHT] + mesh)
        for geometry, axes in zip(geometries, grid[0], strict=True):
            axes.set_title(f"geometry {geometry}")
        for axes in grid[-1]:
            axes.set_xlabel("slack evaluation value dh/df")
        for line in grid:
            _limit_zoom(line[0])
        handles, labels = grid[0][0].get_legend_handles_labels()
        # Beside the title; Ubuntu 24.04's matplotlib has no legends outside the axes.
        figure.legend(handles, labels, loc="upper right", ncols=len(labels), markerscale=1.6)
        figure.suptitle(
            f"Figure {paper.number}: {paper.title}; start: {_SHAPE_WORDS[shape]}",
            x=0.01, ha="left", fontsize=11.5, fontweight="bold",
        )  # fmt: skip
        return _named(_svg(figure), f"f{paper.number}{shape[0]}")


def _limit_zoom(axes: Axes) -> None:
    """Set a smallest range of the y axis, so that numerical noise is not magnified."""
    low, high = axes.get_ylim()
    least = 0.02
    if high - low < least:
        middle = 0.5 * (low + high)
        axes.set_ylim(middle - 0.5 * least, middle + 0.5 * least)


def scatter_map(curves: Curves) -> str:
    """Draw the response to the perturbation over slack, by shape and mesh."""
    meshes = _meshes(curves)
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(11.4, 4.1), layout="constrained")
        both = figure.subplots(1, len(SHAPES), sharey=True)
        for shape, axes in zip(SHAPES, both, strict=True):
            axes.axhspan(SCATTER, 10.0, color="#fdecea", zorder=0)
            _threshold(axes)
            for place, elements in enumerate(meshes):
                for key in curves:
                    if (key.shape, key.elements) == (shape, elements):
                        curve = curves[key]
                        axes.plot(
                            curve.slack + 0.016 * (place - 1.5),
                            np.maximum(curve.response, _LEAST_RESPONSE),
                            _MARKS[place % len(_MARKS)],
                            color=_MESH_COLOURS[place % len(_MESH_COLOURS)],
                            markersize=3.2,
                            markeredgewidth=0.0,
                            alpha=0.8,
                        )
            axes.set_yscale("log")
            axes.set_ylim(_LEAST_RESPONSE, 10.0)
            axes.set_title(f"start: {_SHAPE_WORDS[shape]}")
            axes.set_xlabel("slack evaluation value dh/df")
        both[0].set_ylabel("|change of attitude variation| [rad]")
        both[0].text(0.52, 3.2, "scatter", color="#a50026", fontsize=9)
        _mesh_legend(figure, meshes)
        figure.suptitle(
            "Change of the landing attitude by a perturbation of the slack value by 1e-6",
            x=0.01, ha="left", fontsize=11.5, fontweight="bold",
        )  # fmt: skip
        return _named(_svg(figure), "map")


def dose_response(curves: Curves) -> str:
    """Draw the response over the initial stretch energy, and that energy over slack."""
    meshes = _meshes(curves)
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(11.4, 4.1), layout="constrained")
        left, right = figure.subplots(1, 2)
        left.axhspan(SCATTER, 10.0, color="#fdecea", zorder=0)
        for key, curve in curves.items():
            place = meshes.index(key.elements)
            left.plot(
                curve.stored / curve.released,
                np.maximum(curve.response, _LEAST_RESPONSE),
                _MARKS[place % len(_MARKS)],
                color=_MESH_COLOURS[place % len(_MESH_COLOURS)],
                markersize=3.4,
                markeredgewidth=0.7,
                markerfacecolor="none" if key.shape == RELAXED else None,
                alpha=0.75,
            )
        left.set(xscale="log", yscale="log", ylim=(_LEAST_RESPONSE, 10.0))
        left.set_xlabel("initial stretch energy / energy of the jump [-]")
        left.set_ylabel("|change of attitude variation| [rad]")
        left.set_title("response over initial stretch energy (hollow: static equilibrium)")
        geometry = next((g for g in GEOMETRIES if any(key.geometry == g for key in curves)), "-H")
        cases = dict.fromkeys(key.case for key in curves)
        for case in list(cases)[:1]:
            for shape, line in zip(SHAPES, ("--", "-"), strict=True):
                for key in keys_of(curves, case, geometry, shape):
                    place = meshes.index(key.elements)
                    curve = curves[key]
                    right.plot(
                        curve.slack, curve.stored, line,
                        color=_MESH_COLOURS[place % len(_MESH_COLOURS)],
                    )  # fmt: skip
                    released = curve.released
            right.axhline(released, color="#212529", linewidth=1.0)
            right.text(0.48, released * 1.6, f"energy of the jump, {released:.1f} J", fontsize=9)
            right.set_title(f"initial stretch, geometry {geometry} (dashed: static equilibrium)")
        _threshold(right)
        right.set_yscale("log")
        right.set_xlabel("slack evaluation value dh/df")
        right.set_ylabel("initial stretch energy [J]")
        _mesh_legend(figure, meshes)
        figure.suptitle("Cause of the scatter", x=0.01, ha="left", fontsize=11.5, fontweight="bold")
        return _named(_svg(figure), "dose")


def convergence_plot(found: Sequence[Convergence]) -> str:
    """Draw the differences from the finest mesh, by geometry and shape."""
    meshes = sorted({one.key.elements for one in found})
    with mpl.rc_context(_STYLE):
        above_the_legend = ConstrainedLayoutEngine(rect=(0.0, 0.08, 1.0, 0.92))
        figure = Figure(figsize=(11.4, 4.1), layout=above_the_legend)
        axes_of = figure.subplots(1, 2)
        for axes, name in zip(axes_of, ("height", "turn"), strict=True):
            for number, geometry in enumerate(GEOMETRIES):
                for shape, line in zip(SHAPES, ("-", "--"), strict=True):
                    values = [
                        _worst(
                            getattr(one, name)[1]
                            for one in found
                            if one.key[1:] == (geometry, shape, mesh)
                        )
                        for mesh in meshes[:-1]
                    ]
                    axes.plot(
                        meshes[:-1], values, line + "o", color=_CASE_COLOURS[number],
                        label=f"{geometry}, {_SHAPE_WORDS[shape]}",
                    )  # fmt: skip
            drawn = np.concatenate([line.get_ydata() for line in axes.get_lines()])
            # Without differences from the finest mesh a logarithmic axis is not possible.
            axes.set(
                xscale="log", yscale="log" if np.isfinite(drawn).any() else "linear",
                xticks=meshes[:-1],
            )  # fmt: skip
            axes.set_xticklabels([str(mesh) for mesh in meshes[:-1]])
            axes.minorticks_off()
            axes.set_xlabel("number of elements n")
        axes_of[0].set_ylabel("largest difference of height [m]")
        axes_of[1].set_ylabel("largest difference of attitude variation [rad]")
        handles, labels = axes_of[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="lower center", ncols=3)
        figure.suptitle(
            f"Largest difference from n = {meshes[-1]} over all slack values and cases",
            x=0.01, ha="left", fontsize=11.5, fontweight="bold",
        )  # fmt: skip
        return _named(_svg(figure), "convergence")


def _worst(values: Iterable[float]) -> float:
    finite = [value for value in values if math.isfinite(value) and value > 0.0]
    return max(finite, default=math.nan)


def _meshes(curves: Curves) -> list[int]:
    return sorted({key.elements for key in curves})


def _mesh_legend(figure: Figure, meshes: Sequence[int]) -> None:
    handles = [
        mpl.lines.Line2D(
            [], [], color=_MESH_COLOURS[place % len(_MESH_COLOURS)],
            marker=_MARKS[place % len(_MARKS)], linestyle="none",
        )
        for place in range(len(meshes))
    ]  # fmt: skip
    labels = [f"n = {elements}" for elements in meshes]
    figure.legend(handles, labels, loc="upper right", ncols=len(labels), markerscale=1.6)
