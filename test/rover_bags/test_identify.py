"""Parameters from recorded runs: estimates, parameters that are not identifiable, refusals."""

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from contract_bag import EPOCH_NS, MadeUp

from msg_schemas import topics
from msg_schemas.samples import TextSample
from rover_bags.files.scan import BagScan
from rover_bags.files.store import BagWriter, standard_type
from rover_bags.identification.dry_run import PROCEDURE, TICK, CommandSegment, Manoeuvre, record
from rover_bags.identification.parameters import IdentifyError
from rover_bags.identification.runs import SIGNALS, read_experiments
from rover_cli.command_line import main
from rover_sim import START, load_scenario, load_spatial

HANG = load_spatial("identify_hang")
SHORT = Manoeuvre(duration=2.8, payout=PROCEDURE["identify_hang"].payout, feed_forward=16.2)


@pytest.fixture(scope="module")
def short_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rover that bounces on its tether, which is stiffer than configured."""
    real = HANG.with_overrides({"tether.axial_stiffness": 2.3e4, "start.swing_angle": 0.4})
    path = tmp_path_factory.mktemp("identify") / "bag"
    return record(path, HANG, real, SHORT, seed=11)


def test_observable_parameters_are_found_and_others_are_reported(
    short_bag: Path, capsys: pytest.CaptureFixture[str]
):
    sought = ("EA", "axial_damping", "wheel_friction", "EI")
    arguments = [str(short_bag), *(word for name in sought for word in ("-p", name))]
    assert main(["bag", "identify", *arguments, "--jobs", "1", "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["converged"]
    assert not found["complete"]
    stiffness = found["parameters"]["EA"]
    # 3.5 standard errors.
    assert abs(math.log(stiffness["value"] / 2.3e4)) < 3.5 * stiffness["relative_error"]
    assert 0.0 < stiffness["relative_error"] < 0.02
    assert stiffness["low"] < stiffness["low_individual"] < stiffness["value"] < stiffness["high"]
    damping = found["parameters"]["axial_damping"]
    assert abs(math.log(damping["value"] / 15e-3)) < 3.5 * damping["relative_error"]
    assert all(one["misfit"] < 1.3 for one in found["signals"])
    # The wheels never turned.
    wheel = found["parameters"]["wheel_friction"]
    assert not wheel["identifiable"]
    assert wheel["value"] is wheel["low"] is wheel["high"] is None
    assert "no effect" in wheel["reason"]


@pytest.mark.parametrize("given", [["--seed", "0"], ["--set", "tether.axial_stiffness=2e4"]])
def test_what_belongs_to_a_dry_run_is_refused_without_one(
    given: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert main(["bag", "identify", str(tmp_path / "bag"), *given]) == 2
    assert "give --dry-run as well" in capsys.readouterr().err


def test_uninformative_readings_are_excluded(short_bag: Path):
    (experiment,) = read_experiments(short_bag)
    names = [str(signal) for signal in experiment.signals]
    assert len(names) < len(SIGNALS)  # wheels and flywheel never turned
    assert not any("wheel_left" in name or "flywheel" in name for name in names)
    cell = experiment.readings[:, names.index(f"{topics.LOAD_CELL} force.z")]
    times = experiment.times
    assert np.isnan(cell[(times > 0.7) & (times < 1.4)]).all()  # the drum turned
    assert np.isfinite(cell[times < 0.3]).all()
    assert np.isfinite(cell[times > 1.9]).all()


def refusal(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert main(["bag", "identify", *arguments]) == 2
    return capsys.readouterr().err


def test_refusals_state_the_reason(
    short_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    assert "no bag is given" in refusal([], capsys)
    assert "nowhere" in refusal([str(tmp_path / "nowhere")], capsys)
    assert "should be one of" in refusal([str(short_bag), "-p", "mass"], capsys)
    assert "should be a number" in refusal([str(short_bag), "-p", "EA=much"], capsys)
    assert "should be above 0" in refusal([str(short_bag), "-p", "EA=-1"], capsys)
    assert "long enough" in refusal([str(short_bag), "--until", "1.0"], capsys)
    assert "in this order" in refusal([str(short_bag), "--from", "2", "--until", "1"], capsys)
    empty = MadeUp()
    empty.add(0.0, topics.CONFIG, TextSample(json.dumps({"node": "/other"})))
    assert "no configuration" in refusal([str(empty.write(tmp_path / "empty"))], capsys)
    planar = MadeUp()
    content = {
        "parameters": {"tick": 0.01}, "seed": 0,
        "scenario": load_scenario("paper_table1_high").to_mapping(),
    }  # fmt: skip
    planar.add(0.0, topics.CONFIG, TextSample(json.dumps(content)))
    assert "planar" in refusal([str(planar.write(tmp_path / "planar"))], capsys)
    saved = MadeUp()
    content |= {"scenario": HANG.to_mapping(), START: {}}
    saved.add(0.0, topics.CONFIG, TextSample(json.dumps(content)))
    assert "from a saved state" in refusal([str(saved.write(tmp_path / "saved"))], capsys)


def copy(source: Path, target: Path, is_lost: Callable[[str, float], bool]) -> None:
    """Copy a bag without the messages that are lost, by their topic and time [s]."""
    with BagWriter(target, sync=False) as writer:
        channels: dict[str, int] = {}
        for item in BagScan(source):
            topic = item.topic.name
            if topic not in channels:
                channels[topic] = writer.add_topic(topic, standard_type(item.topic.type))
            if not is_lost(topic, (item.log_ns - EPOCH_NS) / 1e9):
                writer.write(channels[topic], item.log_ns, item.publish_ns, item.data)


def between(first: float, last: float) -> Callable[[str, float], bool]:
    return lambda _topic, at: first < at <= last


def test_encoders_may_be_published_more_seldom_than_other_sensors(tmp_path: Path):
    payout = (CommandSegment(0.5, 1.0, 0.15),)
    wheels = (CommandSegment(0.2, 2.0, 0.15),)
    moved = Manoeuvre(duration=2.4, payout=payout, feed_forward=16.2, wheels=wheels)
    whole = record(tmp_path / "whole", HANG, HANG, moved, seed=3)
    slow = {f"/{topics.WINCH_STATE}", f"/{topics.WHEEL_STATE}"}
    copy(whole, tmp_path / "slow", lambda topic, at: topic in slow and round(at / TICK) % 2 == 1)
    (experiment,) = read_experiments(tmp_path / "slow")
    names, times = [str(signal) for signal in experiment.signals], experiment.times
    wheel = experiment.readings[:, names.index(f"{topics.WHEEL_STATE} wheel_left.position")]
    assert np.isfinite(wheel[(times > 0.5) & (times < 1.9)]).sum() == pytest.approx(17, abs=1)
    cell = experiment.readings[:, names.index(f"{topics.LOAD_CELL} force.z")]
    assert np.isnan(cell[(times > 0.6) & (times < 1.0)]).all()  # the drum turned
    assert np.isfinite(cell[(times > 1.4) & (times < 2.2)]).all()


def test_readings_after_a_gap_are_excluded(short_bag: Path, tmp_path: Path):
    for name, (first, last) in {"late": (0.0, 0.5), "middle": (2.1, 2.5)}.items():
        copy(short_bag, tmp_path / name, between(first, last))
    with pytest.raises(IdentifyError, match=r"from 0\.000 s to 0\.520 s nothing is recorded"):
        read_experiments(tmp_path / "late")
    (cut,) = read_experiments(tmp_path / "middle")
    assert cut.times[-1] < 2.1
    assert "from 2.080 s to 2.520 s" in cut.remark
    assert not any(stamp > 2_100_000_000 for stamp, _, _ in cut.commands)
