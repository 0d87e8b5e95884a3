"""Wall coverage: metrics against closed forms, the plot, and observations from a bag."""

from __future__ import annotations

import io
import math

import numpy as np
import pytest

from msg_schemas import machine, topics
from msg_schemas.samples import JointSample, JointValue
from rover_bags.analysis.wall_coverage import (
    ASSUMED_DISTANCE,
    VIEW_HEIGHT,
    VIEW_WIDTH,
    Observations,
    measure_coverage,
    observations_of,
)
from rover_bags.reading.read import TimeSeries
from rover_bags.views.coverage_plot import draw_coverage

HIGH = 2.0 * 3.0 * math.tan(0.5 * VIEW_HEIGHT)  # height of a footprint [m]
WIDE = VIEW_WIDTH * 3.0  # width of a footprint [m]


def images(*rows: tuple[float, float, float]) -> Observations:
    """Images from depth [m], heading [rad] and smear [px]."""
    depth, heading, smear = np.array(rows, dtype=float).reshape(-1, 3).T
    count = len(depth)
    return Observations(
        np.arange(float(count)), depth, heading, np.full(count, 1e-3), smear, np.full(count, 3.0)
    )


def test_an_image_covers_its_footprint_at_the_wall_distance():
    found = measure_coverage(images((10.0, 0.3, 0.1)))
    assert found.area == pytest.approx(WIDE * HIGH, rel=0.03)
    assert found.headings == pytest.approx(VIEW_WIDTH, abs=math.radians(0.6))
    assert found.share == pytest.approx(VIEW_WIDTH / (2.0 * math.pi), rel=0.03)
    assert (found.images, found.sharp, found.stops) == (1, 1, 1)


@pytest.mark.parametrize("heading", [0.0, math.pi, -math.pi + 0.1, 40.0])
def test_coverage_is_independent_of_heading(heading: float):
    found = measure_coverage(images((10.0, heading, 0.1)))
    assert found.area == pytest.approx(WIDE * HIGH, rel=0.03)


def test_overlapping_footprints_count_once():
    twice = measure_coverage(images((10.0, 0.0, 0.1), (10.0, 2.0 * math.pi, 0.1)))
    assert twice.area == pytest.approx(WIDE * HIGH, rel=0.03)
    beside = measure_coverage(images((10.0, 0.0, 0.1), (10.0, 0.25, 0.1)))
    assert beside.area == pytest.approx(1.5 * WIDE * HIGH, rel=0.03)
    below = measure_coverage(images((10.0, 0.0, 0.1), (10.0 + 0.5 * HIGH, 0.0, 0.1)))
    assert below.area == pytest.approx(1.5 * WIDE * HIGH, rel=0.03)
    assert below.share == pytest.approx(VIEW_WIDTH / (2.0 * math.pi), rel=0.03)


def test_only_sharp_images_cover_and_stops_are_separated_by_depth():
    seen = images((10.0, 0.0, 0.2), (10.01, 0.0, 0.9), (20.0, 0.0, math.nan), (20.0, 1.0, 0.4))
    found = measure_coverage(seen)
    assert (found.images, found.sharp, found.smeared, found.unknown) == (4, 2, 1, 1)
    assert found.stops == 2
    assert (found.depth_first, found.depth_last) == (10.0, 20.0)
    assert found.area == pytest.approx(2.0 * WIDE * HIGH, rel=0.03)
    assert (found.smear_median, found.smear_worst) == (0.4, 0.9)
    whole = (10.0 + HIGH) * 2.0 * math.pi * 3.0
    assert found.share == pytest.approx(found.area / whole, rel=1e-6)
    assert found.summary.startswith("4 images at 2 stops from 10.0 to 20.0 m, 2 sharp, 1 smeared")


@pytest.mark.parametrize("distance", [math.nan, machine.NO_WALL])
def test_the_default_distance_holds_without_a_range(distance: float):
    seen = images((10.0, 0.0, 0.1))._replace(wall_distance=np.array([distance]))
    assert ASSUMED_DISTANCE == 3.0
    assert measure_coverage(seen).area == pytest.approx(WIDE * HIGH, rel=0.03)


def test_no_images_give_no_coverage_and_no_plot():
    found = measure_coverage(images())
    assert found.images == found.stops == 0
    assert math.isnan(found.share)
    assert found.summary == "no images of the wall"
    assert draw_coverage(images()) is None


def test_footprints_are_drawn_at_their_heading_and_wrap_around():
    seen = images((10.0, 0.0, 0.1), (12.0, math.pi, 0.1), (14.0, 0.0, 0.9), (16.0, 0.0, math.nan))
    figure = draw_coverage(seen)
    assert figure is not None
    (axes,) = figure.axes
    boxes = [len(each.get_paths()) for each in axes.collections]
    assert boxes == [3, 1, 1]  # the one at 180 degrees appears at both edges
    first = axes.collections[0].get_paths()[0].get_extents()
    assert (first.width, first.height) == pytest.approx((math.degrees(VIEW_WIDTH), HIGH), rel=1e-6)
    top, bottom = axes.get_ylim()
    assert top > 16.0 + 0.5 * HIGH > 10.0 - 0.5 * HIGH > bottom  # depth downward
    legend = axes.get_legend()
    assert legend is not None
    words = [text.get_text() for text in legend.get_texts()]
    assert [text.split()[0] for text in words] == ["2", "1", "1"]
    figure.savefig(io.BytesIO(), format="svg")


def test_observations_without_smear_and_range_are_read():
    sample = JointSample(
        5_000_000_000,
        {
            machine.PICTURE: JointValue(1.0),
            machine.DEPTH: JointValue(10.0),
            machine.HEADING: JointValue(0.2),
            machine.CAMERA_RATE: JointValue(velocity=1e-3),
        },
    )
    columns = {path: np.array([value]) for path, value in sample.scalars()}
    stamps = np.array([0], dtype=np.int64)
    series = TimeSeries(topics.DESCENT_OBSERVATION, "", np.array([5.0]), stamps, stamps, columns)
    seen = observations_of(series)
    assert (seen.time[0], seen.depth[0], seen.heading[0]) == (5.0, 10.0, 0.2)
    assert seen.camera_rate[0] == 1e-3
    assert math.isnan(seen.smear[0])
    columns.update({f"{machine.SMEAR}.position": np.array([0.3])})
    columns.update({f"{machine.WALL_DISTANCE}.position": np.array([2.5])})
    seen = observations_of(series)
    assert (seen.smear[0], seen.wall_distance[0]) == (0.3, 2.5)
