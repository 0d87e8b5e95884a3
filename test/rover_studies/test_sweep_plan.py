"""Plans of sweeps: runs, random draws, and refusals."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from rover_sim import ScenarioError
from rover_studies.sweep.sweep_plan import Draw, SweepPlan, SweepPlanError, load_plan, make_plan

JUMP: dict[str, Any] = {"scenario": "paper_table1_high"}


def plan(**content: Any) -> SweepPlan:
    return make_plan({**JUMP, **content})


def test_a_factor_multiplies_the_entry_of_a_list_that_the_grid_sets():
    tilts = [[1.0, 2.0, 0.0], [3.0, 2.0, 0.0]]
    factor = {"start.tilt.0": {"factor": {"uniform": [0.99, 1.01]}}}
    found = plan(
        scenario="floor_rubble",
        experiment="spatial_jump",
        set={"start.compression": 0.1},
        grid={"start.tilt": tilts},
        random=factor,
    )
    for number, tilt in enumerate(tilts):
        assert found.run(number).overrides["start.tilt.0"] == pytest.approx(tilt[0], rel=0.01)


def test_every_combination_of_the_grid_comes_once_and_the_last_axis_fastest():
    found = plan(grid={"start.geometry": ["-K", "+K"], "start.slack": [1.0, 2.0, 3.0]})
    rows = [found.row(found.run(number)) for number in range(found.count)]
    assert [(row["start.geometry"], row["start.slack"]) for row in rows] == [
        (geometry, slack) for geometry in ("-K", "+K") for slack in (1.0, 2.0, 3.0)
    ]
    assert [row["run"] for row in rows] == list(range(6))


def test_a_range_includes_both_ends():
    found = plan(grid={"start.slack": {"from": 1.0, "to": 3.0, "count": 5}})
    assert found.values_of("start.slack") == (1.0, 1.5, 2.0, 2.5, 3.0)
    found = plan(grid={"tether.youngs_modulus": {"from": 1e7, "to": 1e9, "count": 3, "log": True}})
    assert found.values_of("tether.youngs_modulus") == pytest.approx((1e7, 1e8, 1e9))


def test_values_that_change_together_are_one_axis():
    found = plan(
        grid={"bodies": [{"rover.m1": 3.0, "rover.m2": 2.0}, {"rover.m1": 4.0, "rover.m2": 1.0}]}
    )
    masses = [found.scenario_of(found.run(number)).rover for number in range(found.count)]
    assert [(rover.m1, rover.m2) for rover in masses if rover] == [(3.0, 2.0), (4.0, 1.0)]


def test_scenarios_may_be_an_axis():
    found = make_plan({"grid": {"scenario": ["paper_table1_low", "paper_table1_high"]}})
    moduli = [found.scenario_of(found.run(number)).tether.youngs_modulus for number in (0, 1)]
    assert moduli == [0.01e9, 0.5e9]


def test_draws_depend_on_seed_and_number_only():
    random = {"start.theta0": {"normal": [0.0, 5.0]}, "start.slack": {"uniform": [1.0, 2.0]}}
    few, many = plan(runs=10, random=random), plan(runs=1000, random=random)
    assert [few.run(number) for number in range(10)] == [many.run(number) for number in range(10)]
    other = plan(runs=10, seed=2, random=random)
    assert few.run(0).overrides != other.run(0).overrides
    assert few.run(0).seed != few.run(1).seed


def test_draws_have_their_distributions():
    found = plan(
        runs=4000,
        random={
            "start.theta0": {"normal": [1.0, 2.0]},
            "start.slack": {"uniform": [1.0, 3.0]},
            "tether.youngs_modulus": {"log_uniform": [1e7, 1e9]},
            "tether.elements": {"integers": [3, 5]},
            "start.geometry": {"choice": ["-K", "+K"]},
            "rover.spring_rate": {"factor": {"normal": [1.0, 0.1], "within": [0.9, 1.1]}},
        },
    )
    rows = [found.run(number).overrides for number in range(found.count)]
    theta = np.array([row["start.theta0"] for row in rows])
    assert theta.mean() == pytest.approx(1.0, abs=0.12)
    assert theta.std() == pytest.approx(2.0, rel=0.06)
    slack = np.array([row["start.slack"] for row in rows])
    assert slack.min() > 1.0
    assert slack.max() < 3.0
    assert slack.mean() == pytest.approx(2.0, abs=0.04)
    moduli = np.log10([row["tether.youngs_modulus"] for row in rows])
    assert moduli.mean() == pytest.approx(8.0, abs=0.05)
    assert {row["tether.elements"] for row in rows} == {3, 4, 5}
    assert {row["start.geometry"] for row in rows} == {"-K", "+K"}
    rates = np.array([row["rover.spring_rate"] for row in rows]) / 824.0
    assert rates.min() >= 0.9
    assert rates.max() <= 1.1


def test_a_value_that_is_invalid_in_some_combinations_is_accepted():
    found = plan(grid={"start.geometry": ["-H", "+K"], "start.slack": [0.3, 1.0]})
    assert found.count == 4
    with pytest.raises(ScenarioError, match="out of reach"):
        found.scenario_of(found.run(0))


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ({"grids": {}}, "grids: no such key"),
        ({"grid": {"start.slak": [1.0]}}, "did you mean 'slack'"),
        ({"grid": {"start.geometry": ["-H", "+Q"]}}, "no run with start.geometry = '+Q'"),
        ({"grid": {"start.slack": []}}, "should be a list of values"),
        ({"grid": {"start.slack": {"from": 1, "to": 2}}}, "should have from, to and count"),
        ({"grid": {"start.slack": {"from": 0, "to": 2, "count": 3, "log": True}}}, "above 0"),
        ({"grid": {"a": [{"rover.m1": 1.0}, {"rover.m2": 1.0}]}}, "should set the same values"),
        ({"random": {"start.theta0": {"gaussian": [0, 1]}}}, "exactly one of uniform"),
        ({"random": {"start.theta0": {"normal": [0, -1]}}}, "standard deviation above 0"),
        ({"random": {"start.theta0": {"uniform": [1, 0]}}}, "[low, high]"),
        ({"random": {"start.theta0": {"uniform": [0, float("nan")]}}}, "two finite numbers"),
        ({"random": {"start.theta0": {"uniform": [0, 1], "within": [2, 3]}}}, "holds 0 of the"),
        ({"random": {"start.theta0": {"normal": [0, 1], "within": [6, 9]}}}, "at least 0.0001"),
        ({"random": {"start.geometry": {"factor": {"uniform": [1, 2]}}}}, "needs a number"),
        ({"runs": 0}, "runs: 0 should be a whole number"),
        ({"runs": 10}, "would be equal"),
        ({"seed": -1}, "seed: -1"),
        ({"scenario": "paper_table9"}, "paper_table9"),
        ({"experiment": "fly"}, "should be one of jump, spatial_jump, run"),
        ({"experiment": "spatial_jump"}, "model = 'planar': should be spatial"),
        ({"scenario": "floor_rubble"}, "model = 'spatial': should be planar"),
        ({"scenario": "floor_rubble", "experiment": "run"}, "model = 'spatial': should be planar"),
        ({"scenario": "tether_pendulum"}, "has no rover, so nothing jumps"),
        (
            {"scenario": "floor_rubble", "experiment": "spatial_jump"},
            "start.compression = 0.0: should be above 0 m",
        ),
        ({"settings": {"max_flight_time": "soon"}}, "settings.max_flight_time: 'soon'"),
        ({"settings": {"limits": 1.0}}, "no such setting"),
        ({"set": {"tether.elements": 0}}, "tether.elements = 0"),
    ],
)
def test_an_invalid_plan_is_refused_by_name(content: dict[str, Any], complaint: str):
    with pytest.raises(SweepPlanError) as caught:
        make_plan({**JUMP, **content})
    assert complaint in str(caught.value)


RARE: dict[str, Any] = {
    "rare_event": {"quantity": "peak_tension_N", "above": 5.0},
    "random": {"start.theta0": {"normal": [0, 5]}},
}


def test_a_rare_event_begins_with_a_round_of_the_plans_distributions():
    found = plan(**RARE)
    assert found.rare_event is not None
    assert (found.rare_event.max_runs, found.rare_event.relative_error) == (10_000, 0.2)
    theta = np.array([found.run(number).overrides["start.theta0"] for number in range(found.count)])
    assert found.count == 2500
    assert theta.mean() == pytest.approx(0.0, abs=0.4)
    assert theta.std() == pytest.approx(5.0, rel=0.06)
    assert found.run(7) == plan(**RARE).run(7)
    assert found.run(7).overrides != plan(**RARE, seed=2).run(7).overrides


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"grid": {"start.slack": [1.0]}}, "has a grid or runs"),
        ({"runs": 10}, "has a grid or runs"),
        ({"random": {}}, "should have random values"),
        ({"random": {f"x.{number}": {"uniform": [0, 1]} for number in range(11)}}, "at most 10"),
        ({"rare_event": {"above": 5.0}}, "rare_event.quantity: null should be one of jump_height"),
        ({"rare_event": {"quantity": "outcome", "above": 5.0}}, "'outcome' should be one of"),
        ({"rare_event": {"quantity": "travel_m"}}, "either above or below"),
        ({"rare_event": {"quantity": "travel_m", "above": 1, "below": 0}}, "either above or below"),
        ({"rare_event": {"quantity": "travel_m", "above": float("nan")}}, "a finite number"),
        ({"rare_event": {"quantity": "travel_m", "above": 1, "limit": 2}}, "rare_event.limit: no"),
        ({"rare_event": {**RARE["rare_event"], "relative_error": 0}}, "0 should be a number from"),
        ({"rare_event": {**RARE["rare_event"], "max_runs": 1999}}, "rare_event.max_runs: 1999"),
        ({"rare_event": {**RARE["rare_event"], "method": "luck"}}, "'luck' should be one of"),
        ({"rare_event": [1]}, "rare_event: [1] should be a mapping"),
    ],
)
def test_a_rare_event_that_makes_no_sense_is_refused(changes: dict[str, Any], complaint: str):
    with pytest.raises(SweepPlanError) as caught:
        make_plan({**JUMP, **RARE, **changes})
    assert complaint in str(caught.value)


@pytest.mark.parametrize(
    ("kind", "numbers", "within", "distribution"),
    [
        ("uniform", (1.0, 5.0), (0.0, 3.0), stats.uniform(1.0, 2.0)),
        ("normal", (1.0, 2.0), (2.0, 9.0), stats.truncnorm(0.5, 4.0, 1.0, 2.0)),
        ("log_uniform", (1.0, 100.0), (10.0, 1000.0), stats.loguniform(10.0, 100.0)),
        ("integers", (1, 6), (2.5, 9.0), stats.randint(3, 7)),
    ],
)
def test_a_range_cuts_a_distribution_off(
    kind: str, numbers: tuple[float, float], within: tuple[float, float], distribution: Any
):
    draw = Draw("x", kind, numbers, within)
    for probability in (1e-6, 0.01, 0.3, 0.77, 0.999, 1.0 - 1e-9):
        value = draw.value(float(stats.norm.ppf(probability)))
        assert value == pytest.approx(float(distribution.ppf(probability)), rel=1e-6)
    shares = {"uniform": 0.5, "normal": 0.30850, "log_uniform": 0.5, "integers": 4 / 6}
    assert draw.share_within == pytest.approx(shares[kind], rel=1e-3)


def test_a_plan_file_names_a_scenario_in_its_folder(tmp_path: Path):
    (tmp_path / "mine.yaml").write_text(
        "name: mine\ngravity: 1.62\n"
        "tether: {length: 2.0, elements: 4, youngs_modulus: 1e8, radius: 1e-3, density: 1e3}\n"
        "start: {geometry: straight, direction: 0.0, initial_shape: straight}\n",
        encoding="utf-8",
    )
    file = tmp_path / "plan.yaml"
    file.write_text(
        "scenario: mine.yaml\nexperiment: run\ngrid: {start.direction: [-80.0, 0.0]}\n",
        encoding="utf-8",
    )
    found = load_plan(file, {"set": {"tether.length": 3.0}})
    assert found.name == "plan"
    assert found.scenario_of(found.run(1)).tether.length == 3.0
    file.write_text("scenario: mine.yaml\nset: [1]\n", encoding="utf-8")
    with pytest.raises(SweepPlanError, match=r"set: \[1\] should be a mapping"):
        load_plan(file, {"set": {"tether.length": 3.0}})
    file.write_text("scenario: [", encoding="utf-8")
    with pytest.raises(SweepPlanError, match="is not YAML"):
        load_plan(file)


@pytest.mark.parametrize("count", [1_000_000_000, 10**30, 100_001, 1, 0, -3, True, 2.0])
def test_an_axis_has_a_bounded_number_of_points(count: object):
    with pytest.raises(SweepPlanError, match="should be a whole number from 2 to 100000"):
        plan(grid={"start.slack": {"from": 1.0, "to": 3.0, "count": count}})


SLACK = {"uniform": [1.0, 2.0]}


HUGE = 10**400
BY_A_FACTOR = {"start.slack": {"factor": {"uniform": [0.9, 1.1]}}}


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ({"random": {"start.slack": {"factor": {"choice": ["a", "b"]}}}},
         "random.start.slack.factor: ['a', 'b'] should be finite numbers"),
        ({"random": {"start.slack": {"factor": {"choice": [[1.0], [2.0]]}}}},
         "random.start.slack.factor: [[1.0], [2.0]] should be finite numbers"),
        ({"random": {"start.slack": {"factor": {"choice": [None, 1.0]}}}},
         "random.start.slack.factor: [None, 1.0] should be finite numbers"),
        ({"grid": {"start.slack": [1.0, None]}, "random": BY_A_FACTOR},
         "random.start.slack: `factor` needs a number to multiply, this is null"),
        ({"grid": {"start.slack": ["a", 1.0]}, "random": BY_A_FACTOR},
         "random.start.slack: `factor` needs a number to multiply, this is 'a'"),
        ({"grid": {"start.slack": [True, 1.0]}, "random": BY_A_FACTOR},
         "random.start.slack: `factor` needs a number to multiply, this is True"),
        ({"random": {"start.slack": {"choice": [HUGE, 1.0]}}}, "random.start.slack.choice: 1000"),
        ({"random": {"tether.elements": {"integers": [4.0, 1e30]}}}, "integers: 1e+30 should be"),
        ({"random": {"start.slack": {"uniform": [0, HUGE]}}}, "should be two finite numbers"),
        ({"random": {"start.theta0": {"normal": [0, 1], "within": [-1, HUGE]}}},
         "random.start.theta0.within: [-1, 1000"),
        ({"grid": {"start.slack": {"from": 1, "to": HUGE, "count": 3}}}, "finite numbers"),
        ({"settings": {"max_flight_time": HUGE}}, "settings.max_flight_time: 1000"),
        ({"random": {"start.theta0": {"normal": [0, 1]}},
          "rare_event": {"quantity": "peak_tension_N", "above": HUGE}}, "with a finite number"),
    ],
)  # fmt: skip
def test_what_is_no_finite_number_is_refused(content: dict[str, Any], complaint: str):
    with pytest.raises(SweepPlanError) as caught:
        plan(**content)
    assert complaint in str(caught.value)


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ({"set": {"start.slack": 1.0}, "grid": {"start.slack": [2.0, 3.0]}},
         "grid.start.slack: given under `set` too"),
        ({"set": {"start.slack": 1.0}, "random": {"start.slack": SLACK}},
         "random.start.slack: given under `set` too"),
        ({"grid": {"start.slack": [2.0, 3.0]}, "random": {"start.slack": SLACK}},
         "random.start.slack: given under `grid` too"),
        ({"grid": {"start.slack": [2.0, 3.0, 2.0]}}, 'grid.start.slack: {"start.slack": 2.0}'),
        ({"grid": {"start.slack": {"from": 1, "to": 1, "count": 3}}}, "stands 3 times"),
        ({"grid": {"start.slack": {"from": 1, "to": 2, "count": 3, "log": "no"}}},
         "grid.start.slack.log: 'no' should be true or false"),
        ({"name": "../../results"}, "name: '../../results' should be the name of a folder"),
        ({"name": ".."}, "should be the name of a folder"),
        ({"name": "/tmp/results"}, "should be the name of a folder"),
        ({"name": "a\0"}, "should be the name of a folder"),
        ({"name": "n" * 500}, "should be the name of a folder"),
    ],
)  # fmt: skip
def test_what_would_be_ignored_or_written_elsewhere_is_refused(
    content: dict[str, Any], complaint: str
):
    with pytest.raises(SweepPlanError) as caught:
        make_plan({**JUMP, **content})
    assert complaint in str(caught.value)


def test_a_factor_multiplies_what_the_grid_gives():
    made = plan(
        grid={"start.slack": [1.0, 2.0]}, random={"start.slack": {"factor": {"choice": [1.1]}}}
    )
    slacks = [made.run(number).overrides["start.slack"] for number in range(made.count)]
    assert slacks == pytest.approx([1.1, 2.2])
