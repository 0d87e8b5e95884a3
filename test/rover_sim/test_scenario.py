"""Planar scenarios: those of the package, refusals, and round trips."""

import json
import math
import tomllib
from dataclasses import FrozenInstanceError, fields, replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rover_sim.scenarios.planar_scenario import (
    PlanarRoverSettings,
    PlanarTetherSettings,
    Scenario,
    TakeOff,
)
from rover_sim.scenarios.scenario import (
    ScenarioError,
    dump_scenario,
    list_scenarios,
    load_planar,
    load_scenario,
    load_spatial,
    parse_override,
    scenario_from_mapping,
)

HIGH = "paper_table1_high"


def refusal(overrides: dict[str, object], name: str = HIGH) -> ScenarioError:
    with pytest.raises(ScenarioError) as caught:
        load_planar(name, overrides)
    return caught.value


class TestShipped:
    def test_the_paper_and_the_references_are_there(self):
        assert {
            "paper_table1_low",
            "paper_table1_high",
            "paper_table2_case1",
            "paper_table2_case2",
            "taut_jump",
            "tether_pendulum",
            "flexible_beam",
        } <= set(list_scenarios())

    @pytest.mark.parametrize("name", list_scenarios())
    def test_each_loads_under_its_own_name_and_has_a_description(self, name: str):
        scenario = load_scenario(name)
        assert scenario.name == name
        assert len(scenario.about) > 40

    @pytest.mark.parametrize("name", list_scenarios())
    def test_each_survives_mapping_json_and_yaml(self, name: str, tmp_path: Path):
        scenario = load_scenario(name)
        passed = json.loads(json.dumps(scenario.to_mapping(), allow_nan=False))
        assert scenario_from_mapping(passed) == scenario
        path = tmp_path / "written.yaml"
        path.write_text(dump_scenario(scenario), encoding="utf-8")
        assert load_scenario(path) == scenario
        assert load_scenario(str(path)) == scenario

    def test_they_are_installed_with_the_package(self):
        configuration = Path(__file__).parents[2]
        text = "".join(
            path.read_text(encoding="utf-8")
            for path in (
                configuration / "setup.py",
                configuration / "setup.cfg",
                configuration / "pyproject.toml",
            )
            if path.exists()
        )
        assert '"rover_sim.scenarios": ["*.yaml", "bases/*.yaml"]' in text
        assert tomllib.loads((configuration / "pyproject.toml").read_text(encoding="utf-8"))

    def test_paper_table_1(self):
        for name, modulus in (("paper_table1_low", 0.01e9), (HIGH, 0.5e9)):
            scenario = load_planar(name)
            tether, rover = scenario.tether, scenario.rover
            assert rover is not None
            assert (tether.length, tether.elements, tether.youngs_modulus) == (5.0, 5, modulus)
            assert (tether.radius, tether.density, scenario.gravity) == (3.45e-4, 1e4, 9.81)
            assert (rover.m1, rover.m2, rover.spring_rate) == (3.0, 2.0, 824.0)
        section = load_planar(HIGH).tether.section
        assert section.axial_stiffness == pytest.approx(0.5e9 * math.pi * 3.45e-4**2, rel=1e-14)
        assert section.bending_stiffness == pytest.approx(5.56335e-6, rel=1e-5)
        assert section.line_density == pytest.approx(1e4 * math.pi * 3.45e-4**2, rel=1e-14)

    def test_paper_table_2(self):
        for name, mass in (("paper_table2_case1", 0.5), ("paper_table2_case2", 0.05)):
            scenario = load_planar(name)
            assert scenario.rover is not None
            assert (scenario.rover.m1, scenario.rover.m2) == (10.0, mass)
            assert scenario.tether.youngs_modulus == 70e9
            assert scenario.tether.density == 2700.0
            assert scenario.theta0 == pytest.approx(math.radians(-10.0))

    def test_the_flexible_beam(self):
        section = load_planar("flexible_beam").tether.section
        assert section.axial_stiffness == pytest.approx(0.7e6 * 0.0018)
        assert section.bending_stiffness == pytest.approx(0.7e6 * 1.215e-8)
        assert section.line_density == pytest.approx(5540.0 * 0.0018)


class TestMeaning:
    def test_take_off_leans_away_from_the_root_at_negative_theta(self):
        scenario = load_planar("paper_table2_case1")
        vx, vy = scenario.take_off_velocity
        assert scenario.tip_position[0] > 0.0
        assert vx > 0.0
        speed = 0.29 * math.sqrt(824.0 / 10.5)
        assert math.hypot(vx, vy) == pytest.approx(speed)
        assert vx / vy == pytest.approx(math.tan(math.radians(10.0)))
        assert scenario.take_off_energy == pytest.approx(0.5 * 824.0 * 0.29**2)

    def test_take_off_by_a_given_velocity(self):
        assert load_planar("taut_jump").take_off_velocity == (1.0, 2.0)
        assert load_planar("taut_jump").take_off_energy == pytest.approx(12.5)

    @pytest.mark.parametrize(
        ("overrides", "tip"),
        [
            ({"start.geometry": "-H", "start.slack": 2.0}, (1.1, -2.2)),
            ({"start.geometry": "-H", "start.slack": 1.0, "start.drop": 3.0}, (3.0, -3.0)),
            ({"start.geometry": "-K", "start.slack": 0.0}, (4.95, 0.0)),
            (
                {"start.geometry": "+K", "start.slack": 2.0},
                (4.95 / math.sqrt(5.0), 9.9 / math.sqrt(5.0)),
            ),
            (
                {"start.geometry": "chord", "start.chord": 4.0, "start.side": "below"},
                (4.0 / math.sqrt(2.0), -4.0 / math.sqrt(2.0)),
            ),
        ],
    )
    def test_geometries(self, overrides: dict[str, object], tip: tuple[float, float]):
        scenario = load_planar(HIGH, overrides)
        assert scenario.tip_position == pytest.approx(tip, abs=1e-12)
        assert scenario.slack_value == pytest.approx(scenario.start.slack)

    def test_a_straight_tether_points_along_its_direction(self):
        scenario = load_planar("tether_pendulum", {"start.direction": -90.0})
        assert scenario.tip_position == pytest.approx((0.0, -5.0), abs=1e-12)
        assert scenario.slack_value == math.inf
        assert scenario.tip_mass == 0.0
        assert scenario.take_off_velocity == (0.0, 0.0)

    def test_inertia_of_uniform_rectangles(self):
        rover = load_planar(HIGH).rover
        assert rover is not None
        assert rover.inertia1 == pytest.approx(3.0 * (0.3**2 + 0.15**2) / 12.0)
        assert rover.inertia2 == pytest.approx(2.0 * (0.2**2 + 0.1**2) / 12.0)

    def test_every_number_has_a_unit_and_a_meaning(self):
        for kind in (PlanarTetherSettings, PlanarRoverSettings, TakeOff, Scenario):
            for item in fields(kind):
                rule = item.metadata["rule"]
                assert rule.about, item.name
                if rule.kind in {int, float}:
                    assert rule.unit, item.name

    def test_frozen(self):
        scenario = load_planar(HIGH)
        with pytest.raises(FrozenInstanceError):
            scenario.gravity = 1.62  # type: ignore[misc]


class TestOverrides:
    def test_by_dotted_path(self):
        scenario = load_planar(
            HIGH, {"start.geometry": "+K", "start.slack": 2, "tether.elements": 20}
        )
        assert (scenario.start.geometry, scenario.start.slack) == ("+K", 2.0)
        assert scenario.tether.elements == 20
        assert load_planar(HIGH).tether.elements == 5

    def test_another_parameter_set_of_the_cross_section(self):
        none = dict.fromkeys(("tether.youngs_modulus", "tether.radius", "tether.density"))
        scenario = load_planar(
            HIGH,
            {
                **none,
                "tether.axial_stiffness": 2e4,
                "tether.bending_stiffness": 1e-4,
                "tether.line_density": 5e-3,
                "tether.breaking_load": 1e3,
            },
        )
        assert scenario.tether.section.axial_stiffness == 2e4
        assert scenario.tether.section.breaking_load == 1e3

    def test_a_whole_section(self):
        scenario = load_planar(HIGH, {"rover": None, "take_off": None, "tip": {"mass": 2.0}})
        assert scenario.rover is None
        assert scenario.tip_mass == 2.0

    def test_of_a_loaded_scenario(self):
        scenario = load_planar(HIGH).with_overrides({"rover.m2": 1.0})
        assert scenario.rover is not None
        assert scenario.rover.m2 == 1.0

    def test_sections_without_a_change_are_shared_and_all_are_checked_together(self):
        scenario = load_spatial("floor_rubble")
        changes = {"start.position": [2.5, 0.0], "tether.length": 12.0}
        changed = scenario.with_overrides(changes)
        assert changed == load_spatial("floor_rubble", changes)
        assert changed.environment is scenario.environment
        assert changed.rover is scenario.rover
        with pytest.raises(ScenarioError, match="should be above"):
            scenario.with_overrides({"tether.length": 3.0})

    def test_an_entry_of_a_list(self):
        scenario = load_spatial("floor_rubble", {"start.position.1": 0.5})
        assert scenario.start.position == (3.0, 0.5)

    @pytest.mark.parametrize("path", ["start.position.2", "start.position.y", "start.position.0.1"])
    def test_an_entry_that_a_list_does_not_have_is_refused(self, path: str):
        with pytest.raises(ScenarioError, match=r"start\.position.* cannot be set"):
            load_spatial("floor_rubble", {path: 0.5})

    def test_as_written_on_a_command_line(self):
        assert parse_override("start.slack=2") == ("start.slack", 2)
        assert parse_override("start.geometry=-H") == ("start.geometry", "-H")
        assert parse_override("tether.youngs_modulus=5e8") == ("tether.youngs_modulus", 5e8)
        assert parse_override("take_off.velocity=[1, 2.0]") == ("take_off.velocity", [1, 2.0])
        assert parse_override("rover=null") == ("rover", None)
        with pytest.raises(ScenarioError, match=r"dotted\.path=value"):
            parse_override("start.slack")


class TestRefusals:
    @pytest.mark.parametrize(
        ("path", "value", "words"),
        [
            ("rover.m2", math.nan, "finite"),
            ("rover.m2", math.inf, "finite"),
            ("rover.m2", -0.5, "above 0"),
            ("rover.m2", 0, "above 0"),
            ("rover.m2", "heavy", "a number"),
            ("rover.m2", True, "a number"),
            ("rover.m2", None, "a number"),
            ("rover.attachment", [0.1], "list of 2"),
            ("rover.attachment", 0.1, "list of 2"),
            ("rover.attachment", "ab", "list of 2"),
            ("tether.elements", 5.0, "whole number"),
            ("tether.elements", 0, "at least 1"),
            ("tether.elements", 10**400, "at most 2000"),
            ("tether.length", 10**400, "finite"),
            ("tether.breaking_load", math.nan, "finite"),
            ("tether.breaking_load", -math.inf, "finite"),
            ("start.slack", -1.0, "at least 0"),
            ("start.slack", None, "needs the slack value"),
            ("start.geometry", "K", "one of -H, -K, +K, chord, straight"),
            ("start.geometry", "straight", "requires straight"),
            ("start.geometry", ["-H"], "one of"),
            ("start.chord_ratio", 1.0, "at most 0.99999"),
            ("start.chord", 4.0, "only geometry chord"),
            ("start", 3, "a mapping of geometry"),
            ("tether", None, "a mapping of"),
            ("gravity", -1.62, "at least 0"),
            ("model", "spacial", "one of"),
            ("name", 3, "text"),
            ("integration.h", 0.0, "at least 1e-06"),
            ("integration.numerical_damping", 1.5, "at most 1"),
            ("integration.max_halvings", -1, "at least 0"),
            ("integration.max_halvings", 17, "at most 16 for h of 0.001 s"),
            ("integration.max_halvings", 10**400, "at most 16 for h of 0.001 s"),
        ],
    )
    def test_one_bad_value(self, path: str, value: object, words: str):
        error = refusal({path: value})
        assert error.path.startswith(path.split(".", maxsplit=1)[0])
        assert words in error.expected
        assert error.path in str(error)

    def test_the_message_names_path_value_and_expected_value(self):
        assert str(refusal({"rover.m2": -0.5})) == (
            "rover.m2 = -0.5: should be a number above 0 and at most 100000 kg"
        )
        assert refusal({"rover.attachment": [0.1, math.nan]}).path == "rover.attachment[1]"

    @pytest.mark.parametrize(("h", "most"), [(0.1, 23), (1e-3, 16), (1e-5, 10), (1e-6, 10)])
    def test_halvings_to_steps_that_would_take_too_long(self, h: float, most: int):
        overrides = {"integration.h": h, "integration.max_halvings": most}
        assert load_planar(HIGH, overrides).integration.max_halvings == most
        with pytest.raises(ScenarioError, match=f"should be at most {most} for h of {h:g} s"):
            load_planar(HIGH, {**overrides, "integration.max_halvings": most + 1})

    @pytest.mark.parametrize("path", ["tether.\n", "a\rb", "name.\u2028.x"])
    def test_a_key_that_breaks_the_line_is_quoted(self, path: str):
        with pytest.raises(ScenarioError) as refused:
            load_planar(HIGH, {path: 1.0})
        assert str(refused.value).isprintable()

    def test_an_unknown_key_with_the_one_that_was_meant(self):
        error = refusal({"start.slak": 1.0})
        assert error.path == "start.slak"
        assert "did you mean 'slack'?" in error.expected
        assert "known here" in refusal({"nothing.like.it": 1.0}).expected
        assert "tether.elements is 5" in refusal({"tether.elements.x": 1}).expected

    def test_a_rover_out_of_the_tethers_reach(self):
        error = refusal({"start.slack": 0.3})
        assert error.path == "start.slack"
        assert "above 0.49" in error.expected
        assert load_planar(HIGH, {"start.slack": 0.491}).start.slack == 0.491
        assert refusal({"start.slack": 0.0}).path == "start.slack"
        assert refusal({"start.drop": 5.5}).path == "start.drop"
        chord = {"start.geometry": "chord", "start.chord": 5.0, "start.side": "above"}
        assert refusal(chord).path == "start.chord"
        assert refusal({"start.geometry": "chord", "start.chord": 4.0}).path == "start.side"

    def test_a_cross_section_given_twice_or_not_at_all(self):
        assert "exactly one of" in refusal({"tether.axial_stiffness": 100.0}).expected
        assert "exactly one of" in refusal({"tether.radius": None}).expected

    def test_inconsistent_sections(self):
        assert refusal({"rover": None}).path == "take_off"
        assert refusal({"take_off": None}).path == "take_off"
        assert refusal({"tip": {"mass": 1.0}}).path == "tip"
        assert refusal({"take_off.velocity": [1.0, 2.0]}).path == "take_off.compression"
        assert refusal({"take_off.compression": None}).path == "take_off.compression"
        assert refusal({"tether.root": "clamped"}).path == "start.direction"
        assert refusal({"start.direction": None}, "tether_pendulum").path == "start.direction"

    def test_building_by_hand_is_checked_too(self):
        scenario = load_planar(HIGH)
        with pytest.raises(ScenarioError, match="gravity"):
            replace(scenario, gravity=math.nan)
        with pytest.raises(ScenarioError, match="compression"):
            TakeOff()
        assert TakeOff(velocity=[1, 2]).velocity == (1.0, 2.0)  # type: ignore[arg-type]

    @pytest.mark.parametrize("missing", ["name", "tether", "start", "gravity"])
    def test_a_missing_key(self, missing: str):
        mapping = load_planar(HIGH).to_mapping()
        del mapping[missing]
        with pytest.raises(ScenarioError, match=f"{missing} = null: missing"):
            Scenario.from_mapping(mapping)

    @given(
        st.recursive(
            st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
            lambda inner: (
                st.lists(inner, max_size=3)
                | st.dictionaries(st.text(max_size=5), inner, max_size=3)
            ),
            max_leaves=5,
        ),
        st.sampled_from(
            [
                "tether.length",
                "tether.elements",
                "tether",
                "rover.attachment",
                "start.geometry",
                "start.slack",
                "take_off",
                "integration.h",
                "about",
                "tip",
            ]
        ),
    )
    def test_any_input_is_accepted_or_refused_in_one_line(self, value: Any, path: str):
        try:
            scenario = load_planar(HIGH, {path: value})
        except ScenarioError as error:
            refused = error
        else:
            assert Scenario.from_mapping(scenario.to_mapping()) == scenario
            return
        assert refused.path
        assert "\n" not in str(refused)


class TestFiles:
    def write(self, folder: Path, content: str) -> Path:
        path = folder / "own.yaml"
        path.write_text(content, encoding="utf-8")
        return path

    def test_a_user_s_file_with_common_number_formats(self, tmp_path: Path):
        text = dump_scenario(load_planar(HIGH)).replace("500000000.0", "5e8")
        assert "5e8" in text
        assert load_scenario(self.write(tmp_path, text)) == load_scenario(HIGH)

    @pytest.mark.parametrize(
        ("content", "words"),
        [
            ("name: [", "is not YAML"),
            ("gravity: 9.81\ngravity: 1.62\n", "stands twice (line 2"),
            ("1: 2\n", "should be text"),
            ("- a\n- b\n", "mapping of keys"),
            ("", "mapping of keys"),
            ("!!python/object/apply:os.system ['true']", "is not YAML"),
        ],
    )
    def test_a_malformed_file(self, tmp_path: Path, content: str, words: str):
        path = self.write(tmp_path, content)
        with pytest.raises(ScenarioError) as caught:
            load_planar(path)
        assert words in str(caught.value)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)

    def test_a_file_that_is_no_text(self, tmp_path: Path):
        path = tmp_path / "own.yaml"
        path.write_bytes(b"\xff\xfe\x00\x01")
        with pytest.raises(ScenarioError, match="UTF-8"):
            load_planar(path)

    def test_no_such_file(self, tmp_path: Path):
        with pytest.raises(ScenarioError, match="No such file"):
            load_planar(tmp_path / "none.yaml")

    def test_no_such_scenario(self):
        with pytest.raises(ScenarioError, match=r"one of .*paper_table1_high"):
            load_planar("paper_table3")
