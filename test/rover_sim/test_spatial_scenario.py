"""Spatial scenarios: those of the package, refusals, and merging with bases."""

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import pytest

from msg_schemas.configuration import Configuration
from rover_sim import (
    Scenario,
    ScenarioError,
    SpatialScenario,
    dump_scenario,
    list_scenarios,
    load_planar,
    load_scenario,
    load_spatial,
    scenario_from_mapping,
)
from rover_sim.physics.ground import terrain_parameters
from rover_sim.scenarios.environment import Environment, Floor, Hole
from rover_sim.scenarios.hardware import RoverSettings, WinchSettings, jump_height, rest_slide
from rover_sim.scenarios.sensor_sections import SensorSettings
from rover_sim.scenarios.spatial_scenario import LONGEST_EXIT, SHORTEST_EXIT, SpatialStartSettings

HANG = "free_hang"


def refusal(overrides: dict[str, object], name: str = HANG) -> ScenarioError:
    with pytest.raises(ScenarioError) as caught:
        load_spatial(name, overrides)
    return caught.value


class TestShipped:
    def test_the_sites_exist(self):
        assert {
            "marius_hills",
            "tranquillitatis",
            "ingenii",
            "lab_rig",
            "floor_rubble",
            "free_hang",
            "slope_15deg",
            "spatial_table1",
        } <= set(list_scenarios("spatial"))
        assert set(list_scenarios("spatial")).isdisjoint(list_scenarios("planar"))
        assert set(list_scenarios()) == {*list_scenarios("spatial"), *list_scenarios("planar")}

    @pytest.mark.parametrize("name", list_scenarios("spatial"))
    def test_each_is_spatial_and_hangs_clear_of_the_ground_or_is_on_it(self, name: str):
        scenario = load_spatial(name)
        count, first = scenario.chain
        whole = count * scenario.tether.nominal_length + first
        assert whole == pytest.approx(scenario.tether.length)
        assert count <= scenario.most_elements
        if scenario.winch is not None:
            share = first / scenario.tether.nominal_length
            assert SHORTEST_EXIT <= share <= LONGEST_EXIT
        if scenario.rover is not None and scenario.start.kind == "hanging":
            reach = scenario.tether.length + 0.28 + scenario.rover.wheels.tip_radius
            assert reach < -scenario.environment.floor_height

    def test_holes_are_as_wide_and_deep_as_published(self):
        for name, least, most, depth in (
            ("marius_hills", 58.0, 65.0, 50.0),
            ("tranquillitatis", 88.0, 100.0, 105.0),
            ("ingenii", 124.0, 130.0, 60.0),
        ):
            hole = load_spatial(name).environment.parameters.hole
            assert hole is not None
            assert 2.0 * hole.narrowest == pytest.approx(least, abs=1e-9)
            assert (hole.diameter, hole.depth) == (most, depth)
        assert load_spatial("lab_rig").gravity == 9.81

    def test_the_default_machine_s_file_has_the_physics_defaults(self):
        scenario = load_spatial(HANG)
        assert scenario.rover == RoverSettings()
        assert scenario.sensors == SensorSettings()
        assert scenario.winch == dataclasses.replace(WinchSettings(), min_length=2.0)

    def test_the_default_rover_jumps_0_37_m_on_the_moon_and_hangs_level(self):
        rover = RoverSettings()
        assert rover.mass == 10.0
        assert jump_height(rover, 1.62, 0.2) == pytest.approx(0.375, abs=0.001)
        light = dataclasses.replace(rover, m1=10.0, m2=0.5)
        assert jump_height(light, 1.62, 0.2) == pytest.approx(0.0457, rel=5e-3)
        assert rest_slide(rover, 0.0) == rover.slider.free_length
        assert rest_slide(rover, 16.48) == pytest.approx(0.18)
        slide = rover.slider.free_length
        lever = np_norm(rover.attachment) - rover.centre_of_mass(slide)[2]
        assert lever == pytest.approx(0.2)

    def test_15_degrees_do_not_topple_it_at_any_heading(self):
        rover = RoverSettings()
        assert rover.tail is not None
        height = rover.centre_of_mass(rover.slider.free_length)[2] + rover.wheels.tip_radius
        for support in (rover.wheels.axle_x, -rover.tail[0], 0.5 * rover.wheels.track_width * 0.7):
            assert math.degrees(math.atan(support / height)) > 15.0


def np_norm(vector: tuple[float, ...]) -> float:
    return math.sqrt(sum(value * value for value in vector))


def configurations(kind: Any) -> set[Any]:
    found = {kind}
    for item in dataclasses.fields(kind):
        inner = item.metadata["rule"].kind
        if dataclasses.is_dataclass(inner):
            found |= configurations(inner)
    return found


class TestMeaning:
    def test_every_number_has_a_unit_and_every_field_a_meaning(self):
        kinds = configurations(SpatialScenario)
        assert len(kinds) > 20
        for kind in kinds:
            for item in dataclasses.fields(kind):
                rule = item.metadata["rule"]
                assert rule.about, (kind, item.name)
                if rule.kind in {int, float}:
                    assert rule.unit, (kind, item.name)

    def test_a_slope_falls_in_its_downhill_direction(self):
        x, y = Floor(slope=15.0, downhill=90.0).gradient
        assert x == pytest.approx(0.0, abs=1e-12)
        assert y == pytest.approx(-math.tan(math.radians(15.0)))

    def test_a_preset_hole_or_one_by_dimensions(self):
        known = Hole(preset="marius_hills", wall_distance=2.0)
        assert known.parameters() == dataclasses.replace(
            terrain_parameters.MARIUS_HILLS, wall_distance=2.0
        )
        own = Hole(diameter=20.0, depth=30.0, overhang=2.0, overhang_depth=10.0)
        assert own.parameters().profile == ((10.0, 0.0), (30.0, 2.0))
        environment = Environment(gravity=1.62, hole=own)
        assert environment.floor_height == -31.0

    def test_without_a_floor_the_ground_is_out_of_reach(self):
        environment = load_spatial(HANG).environment
        assert environment.floor_height == -math.inf
        assert environment.parameters.floor_height < -1e5

    @pytest.mark.parametrize("length", [2.0, 2.4999, 2.5, 3.7, 20.0, 59.9])
    def test_the_element_at_the_fairlead_starts_within_its_limits(self, length: float):
        scenario = load_spatial(HANG, {"tether.length": length})
        count, first = scenario.chain
        assert count + first == pytest.approx(length)
        assert SHORTEST_EXIT <= first <= LONGEST_EXIT


class TestBases:
    def write(self, folder: Path, name: str, content: str) -> Path:
        path = folder / name
        path.write_text(content, encoding="utf-8")
        return path

    def test_sections_are_merged_and_other_values_replaced(self, tmp_path: Path):
        path = self.write(
            tmp_path,
            "own.yaml",
            "name: own\nbase: free_hang\nrover: {m2: 2.0}\nenvironment: {gravity: 3.7}\n",
        )
        own, base = load_spatial(path), load_spatial(HANG)
        assert own.rover is not None
        assert base.rover is not None
        assert (own.rover.m1, own.rover.m2, own.gravity) == (6.0, 2.0, 3.7)
        assert own.environment.floor is None
        assert own.winch == base.winch

    def test_null_removes_a_section(self, tmp_path: Path):
        text = (
            "name: own\nbase: free_hang\nwinch: null\n"
            "tether: {max_length: null}\nrover: null\ntip: {mass: 3.0}\n"
        )
        own = load_spatial(self.write(tmp_path, "own.yaml", text))
        assert own.winch is None
        assert own.rover is None
        assert own.tip_mass == 3.0
        assert own.chain == (20, 0.0)

    def test_a_base_beside_the_file(self, tmp_path: Path):
        self.write(tmp_path, "under.yaml", dump_scenario(load_spatial(HANG)))
        path = self.write(tmp_path, "own.yaml", "name: own\nbase: under.yaml\n")
        assert load_spatial(path) == dataclasses.replace(load_spatial(HANG), name="own")

    def test_invalid_bases(self, tmp_path: Path):
        path = self.write(tmp_path, "own.yaml", "name: own\nbase: nothing\n")
        with pytest.raises(ScenarioError, match=r"base = 'nothing': should be one of default_mach"):
            load_spatial(path)
        self.write(tmp_path, "a.yaml", "base: b.yaml\n")
        path = self.write(tmp_path, "b.yaml", "base: a.yaml\n")
        with pytest.raises(ScenarioError, match="refer back"):
            load_spatial(path)

    @pytest.mark.parametrize("name", list_scenarios("spatial"))
    def test_nothing_is_lost_in_mapping_json_and_yaml(self, name: str, tmp_path: Path):
        scenario = load_spatial(name)
        passed = json.loads(json.dumps(scenario.to_mapping(), allow_nan=False))
        assert scenario_from_mapping(passed) == scenario
        assert load_spatial(self.write(tmp_path, "x.yaml", dump_scenario(scenario))) == scenario

    def test_each_loader_requires_its_model(self):
        with pytest.raises(ScenarioError, match="model = 'spatial': should be planar"):
            load_planar(HANG)
        with pytest.raises(ScenarioError, match="model = 'planar': should be spatial"):
            load_spatial("taut_jump")
        assert isinstance(load_scenario("taut_jump"), Scenario)
        assert isinstance(load_scenario(HANG), SpatialScenario)
        with pytest.raises(ScenarioError, match="model = 'flat': should be one of planar, spatial"):
            load_scenario(HANG, {"model": "flat"})


class TestPartialSections:
    @pytest.mark.parametrize(
        ("name", "path", "value"),
        [
            ("free_hang", "sensors.drum_encoder.scale", 1.02),
            ("spatial_pendulum", "sensors.gyro.bias", 0.01),
            ("spatial_pendulum", "sensors.camera.range_finder.delay", 0.1),
            ("marius_hills", "environment.rock.damping", 0.3),
        ],
    )
    def test_what_is_not_named_keeps_the_section_s_default(
        self, name: str, path: str, value: float
    ):
        overridden = load_spatial(name).with_overrides({path: value})
        assert load_spatial(name, {path: value}) == overridden
        assert overridden != load_spatial(name)

    @pytest.mark.parametrize("order", [1, -1])
    def test_a_value_of_a_section_is_set_after_the_section(self, order: int):
        section = {"kind": "hanging", "twist": 2.0}
        overrides = [("start.swing_angle", 3.0), ("start", section)][::order]
        start = load_spatial(HANG, dict(overrides)).start
        assert (start.swing_angle, start.twist) == (3.0, 2.0)
        assert "swing_angle" not in section


class TestRefusals:
    @pytest.mark.parametrize(
        ("path", "value", "words"),
        [
            ("environment.gravity", -1.62, "at least 0"),
            ("environment.gravity", math.nan, "finite"),
            ("environment.seed", -1, "at least 0"),
            ("environment.hole", {"preset": "copernicus"}, "one of marius_hills"),
            ("tether.length", 100.0, "at least the length"),
            ("tether.max_length", 10.0, "at least the length"),
            ("tether.elements", 10, "exactly one of"),
            ("tether.contact.damping", -1.0, "at least 0"),
            ("tether.swivel_friction", -math.inf, "finite"),
            ("tether.element_length", 5.0, "nominal element lengths"),
            ("winch.min_length", 25.0, "between the winch's min_length"),
            ("winch.efficiency", 1.2, "at most 1"),
            ("winch.friction.breakaway", 0.01, "should be at least the coulomb torque of"),
            ("winch.motor.max_torque", 0.0, "above 0"),
            ("rover.m2", -1.0, "at least 0"),
            ("rover.inertia2", [0.01, 0.01, 0.1], "sum of the other two"),
            ("rover.slider.lower_stop", 0.1, "above the jump drive's stroke"),
            ("rover.wheels.radius", 0.5, "at most 0.3"),
            ("rover.wheels.grouser_height", 0.2, "below the radius"),
            ("rover.attachment", [0.0, 0.0], "list of 3"),
            ("rover.wheel_drive.gear_ratio", "fast", "a number"),
            ("sensors.error_model", "good", "one of full, ideal"),
            ("sensors.gyro.noise_density", -1.0, "at least 0"),
            ("sensors.camera.axis", [0.0, 0.0, 0.0], "zero vector"),
            ("start.kind", "lying", "one of hanging, grounded, straight"),
            ("start.kind", "grounded", "needs a floor"),
            ("start.kind", "straight", "needs a direction"),
            ("start.position", [1.0, 0.0], "no effect on a hanging start"),
            ("tip", {"mass": 1.0}, "should be null"),
            ("integration.h", 0.0, "at least 1e-06"),
            ("integration.h", 1e-9, "at least 1e-06"),
            ("winch.gear_ratio", 1e308, "0 or 1e-30 to 1e+30 in size"),
            ("start.body_rate", [0.0, -1e200, 0.0], "0 or 1e-30 to 1e+30 in size"),
            ("tether.axial_stiffness", 1e-94, "0 or 1e-30 to 1e+30 in size"),
            ("tether.element_length", 1e-3, "makes elements of 0.001 m; should make at most 2000"),
            ("integration.h", 0.05, "at most 0.025 s for winch.motor.servo_bandwidth of 40 rad/s"),
            ("integration.h", 0.022, "or that bandwidth at most 45.4545 rad/s"),
            ("rover.spring_rate", 824.0, "no such key"),
        ],
    )
    def test_one_bad_value(self, path: str, value: object, words: str):
        error = refusal({path: value})
        assert words in str(error)
        assert error.path
        assert "\n" not in str(error)

    def test_a_drum_that_holds_no_tether_or_only_short_layers(self):
        error = refusal({"tether.max_length": None, "winch.min_length": 20.0})
        assert error.path == "winch.min_length"
        assert "below the tether's whole length 20 m" in str(error)
        error = refusal({"winch.layer_pitch": 1e-3, "winch.turns_per_layer": 0.2})
        assert error.path == "winch.turns_per_layer"
        assert "above 0.25" in str(error)

    def test_placed_boulders_lie_in_the_patch_and_differ_in_x(self):
        stones = [{"x": 0.3, "y": 0.1, "diameter": 0.1}, {"x": -0.3, "y": 0.1, "diameter": 0.1}]
        path = "environment.boulders.placed"
        placed = load_spatial("marius_hills", {path: stones}).environment.boulders
        assert placed is not None
        assert [dataclasses.asdict(each) for each in placed.placed] == stones
        for far in ({"x": 11.8}, {"y": -11.8}, {"x": -0.3}, {"diameter": 0.0}):
            error = refusal({path: [{**stones[0], **far}, stones[1]]}, "marius_hills")
            assert next(iter(far)) in str(error)

    def test_a_hole_given_twice_or_half(self):
        assert "preset is marius_hills" in str(
            refusal({"environment.hole.diameter": 10.0}, "marius_hills")
        )
        assert "needed" in str(refusal({"environment.hole.preset": None}, "marius_hills"))
        assert "together" in str(
            refusal(
                {"environment.hole": {"diameter": 9.0, "depth": 9.0, "overhang": 1.0}}, "ingenii"
            )
        )

    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            (
                {"environment.patch.half_width": 200.0, "environment.relief.spacing": 0.1},
                "should be at least 0.2 m on a patch of 400 m",
            ),
            ({"environment.relief.spacing": 5e-11}, "at most 2000 nodes along a side"),
            (
                {"environment.patch.half_width": 200.0, "environment.boulders.density": 20.0},
                "should be at most 0.625 1/m^2 on a patch of 400 m",
            ),
            ({"environment.boulders.smallest": 1e-12}, "at least 0.001"),
        ],
    )
    def test_ground_that_does_not_fit_the_memory(self, changes: dict[str, object], words: str):
        assert words in str(refusal(changes, "floor_rubble"))

    def test_boulders_that_cross_too_many_cells(self):
        huge = {
            "environment.patch.half_width": 200.0,
            "environment.boulders": {
                "density": 0.5, "smallest": 50.0, "largest": 60.0, "clear_radius": 0.0
            },
        }  # fmt: skip
        scenario = load_spatial("floor_rubble", huge)
        with pytest.raises(ScenarioError, match=r"largest = 60\.0: .* fit the memory"):
            scenario.environment.build()

    def test_a_rover_out_of_the_tether_s_reach(self):
        error = refusal({"start.position": [20.0, 0.0]}, "floor_rubble")
        assert error.path == "tether.length"
        assert "does not reach" in error.expected

    def test_building_by_hand_is_checked_too(self):
        scenario = load_spatial(HANG)
        with pytest.raises(ScenarioError, match="m1"):
            dataclasses.replace(RoverSettings(), m1=math.nan)
        with pytest.raises(ScenarioError, match="tip"):
            scenario.with_overrides({"tip": {"mass": 1.0}})
        with pytest.raises(dataclasses.FrozenInstanceError):
            scenario.name = "other"  # type: ignore[misc]
        assert isinstance(SpatialStartSettings(kind="hanging"), Configuration)

    def test_the_message_names_path_value_and_expected_value(self):
        message: Any = str(refusal({"rover.jump_drive.efficiency": 2.0}))
        assert message == (
            "rover.jump_drive.efficiency = 2.0: should be a number above 0 and at most 1"
        )
