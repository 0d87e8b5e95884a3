"""Sensors: closed forms of the signals, statistics of the errors, and repeatability."""

import dataclasses
import math

import numpy as np
import pytest
from numpy.typing import ArrayLike

from rover_sim.devices.sensors import Readings, SensorState, SensorSuite, Truth, spread
from rover_sim.physics.ground.ray import distance_to_ground
from rover_sim.physics.ground.terrain import build_terrain
from rover_sim.physics.ground.terrain_parameters import HoleParameters, TerrainParameters
from rover_sim.physics.rover.body_motion import BodyMotion, image_rate, mean_rate, specific_force
from rover_sim.physics.tether.ancf import Array
from rover_sim.scenarios.sensor_sections import CameraSettings, SensorErrors, SensorSettings

PERFECT = SensorSettings(error_model="ideal")
QUIET = SensorErrors()
G = 1.62


def quaternion(vector: ArrayLike) -> tuple[float, float, float, float]:
    turn = np.asarray(vector, dtype=np.float64)
    angle = float(np.linalg.norm(turn))
    x, y, z = (math.sin(angle / 2) / angle * turn).tolist() if angle else (0.0, 0.0, 0.0)
    return math.cos(angle / 2), x, y, z


def still(time: float, **others: object) -> Truth:
    body = BodyMotion((0.0, 0.0, -10.0), (1.0, 0.0, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3)
    return dataclasses.replace(Truth(time, body), **others)  # type: ignore[arg-type]


def only(**channels: SensorErrors) -> SensorSettings:
    """Sensors without errors except those of the named channels."""
    names = (
        "gyro",
        "accelerometer",
        "flywheel_encoder",
        "wheel_encoders",
        "drum_encoder",
        "currents",
        "fairlead_load_cell",
        "rover_load_cell",
    )
    camera = CameraSettings(range_finder=channels.pop("range_finder", QUIET))
    return SensorSettings(camera=camera, **{**dict.fromkeys(names, QUIET), **channels})  # type: ignore[arg-type]


def run(suite: SensorSuite, truths: list[Truth]) -> list[Readings]:
    state = suite.start(truths[0])
    found = []
    for truth in truths[1:]:
        state, readings = suite.step(state, truth)
        found.append(readings)
    return found


# ------------------------------------------------------------------------------ what is true


def test_the_gyro_measures_the_rotation_of_the_tick_however_large() -> None:
    start = np.array([0.3, -0.2, 0.5])
    for turn in ([0.4, 0.0, 0.0], [1e-9, 2e-9, 0.0], [1.0, -2.0, 1.5]):
        before = quaternion(start)
        # body rotated further by `turn` in its own axes
        w0, v0 = before[0], np.array(before[1:])
        w1, *rest = quaternion(turn)
        v1 = np.array(rest)
        after = np.array([w0 * w1 - v0 @ v1, *(w0 * v1 + w1 * v0 + np.cross(v0, v1))])
        for sign in (1.0, -1.0):
            assert mean_rate(before, tuple((sign * after).tolist()), 0.01) == pytest.approx(
                np.array(turn) / 0.01, rel=1e-9, abs=1e-12
            )


def test_at_rest_the_accelerometer_measures_the_reaction_to_gravity_in_its_axes() -> None:
    rest = BodyMotion(
        (0.0, 0.0, 0.0), quaternion([0.0, math.radians(30.0), 0.0]), (0.0,) * 3, (0.0,) * 3
    )
    force = specific_force(rest, rest, (0.1, 0.2, 0.3), G, 0.01)
    # pitched down (about +y): gravity's reaction points backward in the body
    assert force == pytest.approx(
        [-G * math.sin(math.radians(30)), 0.0, G * math.cos(math.radians(30))]
    )


def test_in_free_fall_it_measures_zero_and_on_a_circle_the_centripetal_acceleration() -> None:
    one = (1.0, 0.0, 0.0, 0.0)
    before = BodyMotion((0.0, 0.0, 0.0), one, (1.0, 0.0, 2.0), (0.0,) * 3)
    after = before._replace(velocity=(1.0, 0.0, 2.0 - G * 0.01))
    assert specific_force(before, after, (0.1, 0.0, 0.0), G, 0.01) == pytest.approx(np.zeros(3))
    # rotation about z at rate w, the sensor a distance r ahead: w^2 r towards the axis
    w, r, dt = 3.0, 0.2, 1e-3
    spin = (0.0, 0.0, w)
    first = BodyMotion((0.0,) * 3, quaternion([0.0, 0.0, -0.5 * w * dt]), (0.0,) * 3, spin)
    second = first._replace(orientation=quaternion([0.0, 0.0, 0.5 * w * dt]))
    force = specific_force(first, second, (r, 0.0, 0.0), 0.0, dt)
    assert force == pytest.approx([-w * w * r, 0.0, 0.0], rel=1e-5, abs=1e-9)


def test_mean_specific_force_does_not_depend_on_the_tick() -> None:
    """The mean over 10 ms is the mean of ten means over 1 ms, for a swinging body."""

    def motion(t: float) -> BodyMotion:
        angle, rate = 0.1 * math.sin(3.0 * t), 0.3 * math.cos(3.0 * t)
        velocity = (rate * 10.0 * math.cos(angle), 0.0, rate * 10.0 * math.sin(angle))
        return BodyMotion((0.0,) * 3, quaternion([0.0, -angle, 0.0]), velocity, (0.0, -rate, 0.0))

    whole = specific_force(motion(0.2), motion(0.21), (0.05, 0.0, 0.0), G, 0.01)
    parts = [
        specific_force(motion(0.2 + k * 1e-3), motion(0.201 + k * 1e-3), (0.05, 0.0, 0.0), G, 1e-3)
        for k in range(10)
    ]
    assert whole == pytest.approx(np.mean(parts, axis=0), abs=1e-4)


def test_an_ideal_suite_measures_the_truth() -> None:
    truth = still(
        0.01,
        nut=0.02,
        flywheel_angle=62.8,
        flywheel_rate=3.0,
        wheel_angles=(1.0, 2.0),
        wheel_rates=(0.1, 0.2),
        length=12.3,
        payout_rate=0.4,
        brake_closed=False,
        currents=(0.1, -0.2, 0.3),
        fairlead_tension=16.0,
        rover_tension=15.0,
        wheel_loads=(3.0, 0.1),
        body_load=0.0,
    )
    (readings,) = run(SensorSuite(PERFECT, G, pitch=3e-4), [still(0.0), truth])
    for name in (
        "nut", "flywheel_angle", "flywheel_rate", "wheel_angles", "wheel_rates", "length",
        "payout_rate", "brake_closed", "currents", "fairlead_tension", "rover_tension",
    ):  # fmt: skip
        assert getattr(readings, name) == getattr(truth, name), name
    assert readings.nut_rate == pytest.approx(9e-4)
    assert readings.gyro == (0.0, 0.0, 0.0)
    assert readings.specific_force == pytest.approx((0.0, 0.0, G))
    assert readings.wheel_contacts == (True, False)
    assert readings.body_contact is False
    assert readings.on_ground is True
    assert readings.wall_distance == math.inf


# ------------------------------------------------------------------------------- the camera


def test_smear_of_a_steady_turn_is_rate_times_exposure_over_pixel() -> None:
    """0.5 mrad pixels and 100 ms: 0.2865 deg/s smear by one pixel."""
    rate = math.radians(0.2865)
    truths = [
        still(0.01 * k)
        if k == 0
        else Truth(
            0.01 * k,
            BodyMotion(
                (0.0,) * 3, quaternion([0.0, 0.0, rate * 0.01 * k]), (0.0,) * 3, (0.0, 0.0, rate)
            ),
        )
        for k in range(31)
    ]
    truths[0] = truths[0].__class__(0.0, truths[1].body)
    readings = run(SensorSuite(PERFECT, G), truths)
    assert readings[-1].smear == pytest.approx(1.0, rel=1e-3)
    assert readings[4].smear == pytest.approx(0.5, rel=1e-3)  # the shutter has just opened


def test_smear_does_not_depend_on_the_tick() -> None:
    def smear(dt: float) -> float:
        body = BodyMotion((0.0,) * 3, (1.0, 0.0, 0.0, 0.0), (0.0,) * 3, (0.0, 0.01, 0.02))
        count = round(0.5 / dt)
        return run(SensorSuite(PERFECT, G), [Truth(dt * k, body) for k in range(count + 1)])[
            -1
        ].smear

    assert smear(0.01) == pytest.approx(math.hypot(0.01, 0.02) * 0.1 / 0.5e-3, rel=1e-6)
    assert smear(0.01) == pytest.approx(smear(0.001), rel=1e-6)
    assert smear(0.03) == pytest.approx(smear(0.001), rel=1e-6)


def test_a_rotation_that_compensates_a_sideways_motion_keeps_the_image_still() -> None:
    # looking along -x at a wall 3 m away, moving along +y: turning about -z follows the point
    v, distance = 0.2, 3.0
    body = BodyMotion((0.0,) * 3, (1.0, 0.0, 0.0, 0.0), (0.5, v, 0.0), (0.0,) * 3)
    axis = (-1.0, 0.0, 0.0)
    assert image_rate(body, (0.0,) * 3, axis, distance) == pytest.approx([0.0, -v / distance, 0.0])
    followed = body._replace(spin=(0.0, 0.0, v / distance))
    assert image_rate(followed, (0.0,) * 3, axis, distance) == pytest.approx(np.zeros(3), abs=1e-15)
    assert image_rate(body, (0.0,) * 3, axis, math.inf) == pytest.approx(np.zeros(3))
    roll = body._replace(velocity=(0.0,) * 3, spin=(2.0, 0.0, 0.0))
    assert image_rate(roll, (0.0,) * 3, axis, distance) == pytest.approx(np.zeros(3))


def test_spread() -> None:
    assert spread([]) == spread([(1.0, 1.0)]) == 0.0
    assert spread([(0.0, 0.0), (3.0, 4.0), (1.0, 1.0)]) == pytest.approx(5.0)


def test_the_range_finder_sees_wall_and_floor_where_they_are() -> None:
    hole = HoleParameters(diameter=20.0, depth=30.0, wall_distance=3.0)
    terrain = build_terrain(TerrainParameters(hole=hole))
    # the wall is at x = -3 m from the fairlead
    assert distance_to_ground(terrain, (0.0, 0.0, -10.0), (-1.0, 0.0, 0.0), 50.0) == pytest.approx(
        3.0
    )
    across = distance_to_ground(terrain, (0.0, 0.0, -10.0), (1.0, 0.0, 0.0), 50.0)
    assert across == pytest.approx(17.0)
    for reach in (5.0, 16.9):
        assert distance_to_ground(terrain, (0.0, 0.0, -10.0), (1.0, 0.0, 0.0), reach) == math.inf
    down = distance_to_ground(terrain, (5.0, 0.0, -10.0), (0.0, 0.0, -1.0), 50.0)
    assert down == pytest.approx(21.0)
    oblique = distance_to_ground(terrain, (0.0, 0.0, -10.0), (-0.6, 0.0, -0.8), 50.0)
    assert oblique == pytest.approx(5.0)
    assert distance_to_ground(terrain, (-4.0, 0.0, -10.0), (1.0, 0.0, 0.0), 5.0) == 0.0
    suite = SensorSuite(PERFECT, G, terrain=terrain)
    (readings,) = run(suite, [still(0.0), still(0.01)])
    assert readings.wall_distance == pytest.approx(3.0 - 0.16)


# ------------------------------------------------------------------------------- the errors


def gyro_of(sensors: SensorSettings, dt: float, count: int, seed: int = 5) -> Array:
    suite = SensorSuite(sensors, G, seed=seed)
    return np.array([r.gyro for r in run(suite, [still(dt * k) for k in range(count + 1)])])


def test_the_default_gyro_has_0_05_deg_s_a_sample_at_100_hz() -> None:
    sensors = only(gyro=dataclasses.replace(SensorSettings().gyro, bias=0.0, bias_random_walk=0.0))
    read = gyro_of(sensors, 0.01, 2000)
    assert np.degrees(read.std()) == pytest.approx(0.05, rel=0.03)
    assert abs(read.mean()) < 4.0 * read.std() / math.sqrt(read.size)
    # white: neighbours are uncorrelated
    assert abs(np.corrcoef(read[1:, 0], read[:-1, 0])[0, 1]) < 0.1


def test_noise_does_not_depend_on_the_tick() -> None:
    sensors = only(gyro=SensorErrors(noise_density=1e-3))
    fine, coarse = gyro_of(sensors, 0.002, 4000), gyro_of(sensors, 0.01, 800)
    averaged = fine.reshape(800, 5, 3).mean(axis=1)
    assert averaged.std() == pytest.approx(coarse.std(), rel=0.06)
    assert coarse.std() == pytest.approx(1e-3 / math.sqrt(0.01), rel=0.04)


def test_the_scale_multiplies_the_signal_before_the_bias() -> None:
    truths = [still(0.01 * k, fairlead_tension=20.0) for k in range(2)]
    drawn = [
        run(SensorSuite(only(fairlead_load_cell=SensorErrors(scale=scale, bias=0.1)), G), truths)
        for scale in (1.0, 1.03)
    ]
    (nominal,), (scaled,) = drawn
    assert nominal.fairlead_tension != 20.0
    assert scaled.fairlead_tension - nominal.fairlead_tension == pytest.approx(0.6)


def test_a_bias_starts_at_random_and_grows_with_the_square_root_of_time() -> None:
    sensors = only(gyro=SensorErrors(bias=0.1))
    drawn = np.array([gyro_of(sensors, 0.01, 1, seed)[0] for seed in range(400)])
    assert drawn.std() == pytest.approx(0.1, rel=0.08)
    walk = only(gyro=SensorErrors(bias_random_walk=0.02))
    for dt in (0.01, 0.05):
        ends = np.array([gyro_of(walk, dt, round(1.0 / dt), seed)[-1] for seed in range(100)])
        assert ends.std() == pytest.approx(0.02, rel=0.15)


def test_saturation_and_resolution() -> None:
    sensors = only(
        fairlead_load_cell=SensorErrors(range=500.0), rover_load_cell=SensorErrors(resolution=0.25)
    )
    high = still(0.01, fairlead_tension=800.0, rover_tension=16.1)
    (readings,) = run(SensorSuite(sensors, G), [still(0.0), high])
    assert readings.fairlead_tension == 500.0
    assert readings.rover_tension == 16.0


def test_an_encoder_counts_and_its_rate_comes_from_its_counts() -> None:
    step = 0.1
    sensors = only(wheel_encoders=SensorErrors(resolution=step))
    truths = [
        still(0.01 * k, wheel_angles=(0.012 * k, 0.0), wheel_rates=(1.2, 0.0)) for k in range(201)
    ]
    readings = run(SensorSuite(sensors, G), truths)
    angles = np.array([r.wheel_angles[0] for r in readings])
    rates = np.array([r.wheel_rates[0] for r in readings])
    assert np.abs(angles - 0.012 * np.arange(1, 201)).max() <= 0.5 * step + 1e-12
    assert angles / step == pytest.approx(np.round(angles / step), abs=1e-9)
    assert set(np.round(rates, 6)) == {0.0, 10.0}
    assert rates.mean() == pytest.approx(1.2, rel=0.03)


@pytest.mark.parametrize(
    "errors", [{"scale": 1.01}, {"bias": 0.5}, {"range": 5.0}, {"scale": 0.9, "bias": 0.1}]
)
def test_the_first_rate_of_an_encoder_at_rest_is_zero(errors: dict[str, float]) -> None:
    encoder = SensorErrors(resolution=1e-3, **errors)
    settings = only(flywheel_encoder=encoder, wheel_encoders=encoder, drum_encoder=encoder)
    at_rest = {"flywheel_angle": 9.0, "wheel_angles": (7.0, -8.0), "length": 20.0}
    truths = [still(0.01 * k, **at_rest) for k in range(3)]
    for readings in run(SensorSuite(settings, G, seed=1), truths):
        assert readings.flywheel_rate == readings.payout_rate == 0.0
        assert readings.wheel_rates == (0.0, 0.0)


@pytest.mark.parametrize("errors", [{"scale": 1.1}, {"delay": 0.05}, {"noise_density": 0.1}])
def test_the_rate_of_an_encoder_without_counts_has_its_errors_too(errors: dict[str, float]) -> None:
    truths = [still(0.01 * k, length=0.1 * (0.01 * k) ** 2, payout_rate=2e-3 * k) for k in range(9)]
    before, after = run(SensorSuite(only(drum_encoder=SensorErrors(**errors)), G), truths)[-2:]
    assert after.payout_rate == pytest.approx((after.length - before.length) / 0.01)
    assert after.payout_rate != pytest.approx(truths[-1].payout_rate, rel=1e-3)


@pytest.mark.parametrize(
    "errors",
    [{"bias_random_walk": 0.1}, {"bias": 0.5}, {"noise_density": 0.1}, {"range": 5.0}],
)
def test_the_nut_is_measured_by_the_encoder_of_its_motor(errors: dict[str, float]) -> None:
    encoder = SensorErrors(resolution=1e-3, **errors)
    truths = [still(0.01 * k, flywheel_angle=9.0 * k, nut=9e-3 * k) for k in range(9)]
    suite = SensorSuite(only(flywheel_encoder=encoder), G, pitch=1e-3)
    for readings in run(suite, truths):
        assert readings.nut == pytest.approx(1e-3 * readings.flywheel_angle, abs=2e-6)


def test_a_delay_is_exact_at_any_tick() -> None:
    sensors = only(fairlead_load_cell=SensorErrors(delay=0.025))
    for dt in (0.01, 0.004):
        truths = [
            still(dt * k, fairlead_tension=100.0 * dt * k) for k in range(round(0.4 / dt) + 1)
        ]
        readings = run(SensorSuite(sensors, G), truths)
        assert readings[-1].fairlead_tension == pytest.approx(100.0 * (0.4 - 0.025))
        assert readings[0].fairlead_tension == 0.0  # before the start the signal is constant


def test_a_delayed_distance_is_never_between_a_finite_one_and_infinity() -> None:
    hole = HoleParameters(diameter=20.0, depth=30.0, wall_distance=3.0)
    terrain = build_terrain(TerrainParameters(hole=hole))
    truths = []
    for k in range(30):
        place = (0.0, 0.0, 50.0 if 10 <= k < 20 else -10.0)
        body = BodyMotion(place, (1.0, 0.0, 0.0, 0.0), (0.0,) * 3, (0.0,) * 3)
        truths.append(Truth(0.01 * k, body))

    def distances(errors: SensorErrors) -> list[float]:
        suite = SensorSuite(only(range_finder=errors), G, terrain=terrain)
        return [readings.wall_distance for readings in run(suite, truths)]

    exact, delayed = distances(QUIET), distances(SensorErrors(delay=0.025))
    assert math.inf in exact
    assert min(exact) < math.inf
    # late by 2.5 ticks and held from tick to tick: by three ticks
    assert delayed[3:] == exact[:-3]


def test_memory_does_not_grow() -> None:
    suite = SensorSuite(only(gyro=SensorErrors(delay=0.05)), G)
    state = suite.start(still(0.0))
    for k in range(1, 500):
        state, _ = suite.step(state, still(0.01 * k))
    assert len(state.signals) <= 7
    assert len(state.image) <= 13


# ------------------------------------------------------------------------------ determinism


def test_equal_seeds_give_equal_readings_and_others_do_not() -> None:
    truths = [still(0.01 * k, fairlead_tension=16.0) for k in range(20)]
    first = run(SensorSuite(SensorSettings(), G, seed=3), truths)
    assert run(SensorSuite(SensorSettings(), G, seed=3), truths) == first
    assert run(SensorSuite(SensorSettings(seed=3), G), truths) == first
    assert run(SensorSuite(SensorSettings(), G, seed=4), truths)[5].gyro != first[5].gyro


def test_a_step_does_not_change_its_state_and_is_repeatable() -> None:
    suite = SensorSuite(SensorSettings(), G)
    state = suite.start(still(0.0))
    state, _ = suite.step(state, still(0.01))
    kept = dataclasses.asdict(state)
    once, twice = suite.step(state, still(0.02)), suite.step(state, still(0.02))
    assert once[1] == twice[1]
    after = dataclasses.asdict(state)
    assert all(np.array_equal(np.array(after[k], dtype=object), np.array(kept[k], dtype=object))
               for k in ("tick", "bias", "angles"))  # fmt: skip
    assert isinstance(state, SensorState)


def test_one_channel_s_errors_do_not_shift_another_s() -> None:
    truths = [still(0.01 * k) for k in range(5)]
    alone = run(SensorSuite(only(gyro=SensorErrors(noise_density=1e-3)), G), truths)
    both = run(
        SensorSuite(
            only(gyro=SensorErrors(noise_density=1e-3), currents=SensorErrors(noise_density=1.0)), G
        ),
        truths,
    )
    assert [r.gyro for r in alone] == [r.gyro for r in both]


def test_a_step_without_elapsed_time_is_refused() -> None:
    suite = SensorSuite(PERFECT, G)
    with pytest.raises(ValueError, match="time"):
        suite.step(suite.start(still(1.0)), still(1.0))
