"""Mission plans: what is read, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from msg_schemas.shipped import ShippedError
from rover_control.mission.mission_plan import load_plan, shipped
from rover_control.mission.mission_route import LegKind, itinerary

GOOD = """
stow: 2.0
looks: [{depth: 4.0, turns: [30, -60]}]
landing: {approach_depth: 6.0, max_depth: 9.0}
survey: [{x: 1.0, y: 0.5}, {x: 2.0, y: 0.0, heading: 90}]
"""


def written(folder: Path, text: str) -> str:
    path = folder / "plan.yaml"
    path.write_text(text, encoding="utf-8")
    return str(path)


@pytest.mark.parametrize("name", shipped())
def test_every_shipped_plan_is_valid(name: str):
    legs = itinerary(load_plan(name))
    assert legs[-1].kind is LegKind.STOW
    assert LegKind.LAND in [leg.kind for leg in legs]


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (GOOD.replace("stow", "stowe"), "stowe"),
        (GOOD.replace("depth: 4.0", "depth: 1.0"), "looks[0].depth"),
        (GOOD.replace("[30, -60]", "[0]"), "turns[0]"),
        (GOOD.replace("[30, -60]", "left"), "turns"),
        (GOOD.replace("approach_depth: 6.0", "approach_depth: 3.0"), "landing.approach_depth"),
        (GOOD.replace("max_depth: 9.0", "max_depth: 5.0"), "landing.max_depth"),
        (GOOD.replace("landing: {approach_depth: 6.0, max_depth: 9.0}", ""), "survey"),
        (GOOD + "lift: {height: 5.0}\n", "lift.height"),
        (GOOD + "jumps: {stroke: 3.0}\n", "jumps.stroke"),
        (GOOD.replace("y: 0.5", "y: 0.5, jump_height: 0.005"), "jump_height"),
        ("stow: [", "plan.yaml"),
    ],
)
def test_an_invalid_plan_is_refused_with_its_key(tmp_path: Path, text: str, named: str):
    with pytest.raises(ShippedError) as caught:
        load_plan(written(tmp_path, text))
    assert named in str(caught.value)
    assert "plan.yaml" in str(caught.value)


def test_an_unknown_plan_name_is_refused_with_the_valid_ones():
    with pytest.raises(ShippedError, match="shallow"):
        load_plan("deep")


def test_different_plans_have_different_digests(tmp_path: Path):
    one = load_plan(written(tmp_path, GOOD)).digest
    other = load_plan(written(tmp_path, GOOD.replace("4.0", "4.5"))).digest
    assert one != other
    assert one == load_plan(written(tmp_path, GOOD)).digest
