"""Invalid input without ROS: messages to the codecs, scenarios to the loader."""

from __future__ import annotations

import math
from importlib import resources

import numpy as np

from msg_schemas.cdr import pack, unpack
from msg_schemas.refusal import Refusal
from msg_schemas.samples import JointSample, JointValue
from msg_schemas.table import TOPICS, Intent, Topic
from rover_sim import ScenarioError, list_scenarios, load_scenario
from rover_verify.checks import CheckBatch, Measured
from rover_verify.harness.hil_invalid import ERRORS
from rover_verify.harness.joint_message import PARTS, JointMessage

_MESSAGES_A_RUN = 500
_NOW_NS = 1_000_000_000_000


def _commands() -> list[Topic]:
    return [row for row in TOPICS.values() if row.intent is Intent.COMMAND and row.joints]


def _good(row: Topic, generator: np.random.Generator) -> JointSample:
    values = {}
    joints = row.joints
    if row.one_joint:
        joints = (joints[int(generator.integers(len(joints)))],)
    for joint in joints:
        numbers = []
        for part in PARTS:
            field = row.by_path[f"{joint}.{part}"]
            low, high = max(field.minimum, -1e3), min(field.maximum, 1e3)
            numbers.append(float(generator.uniform(low, high)) if high > low else low)
        values[joint] = JointValue(*numbers)
    return JointSample(_NOW_NS, values)


def good_commands(batch: CheckBatch) -> Measured:
    """Number of random valid commands that their codec changes."""
    bad = total = 0
    for generator in batch.generators():
        for _ in range(_MESSAGES_A_RUN // 5):
            for row in _commands():
                sample = _good(row, generator)
                total += 1
                bad += unpack(row.name, pack(row.name, sample), _NOW_NS) != sample
    return Measured(bad, f"of {total} commands")


def bad_commands(batch: CheckBatch) -> Measured:
    """Number of random invalid commands not refused with the right code and reason."""
    missed, total, details = 0, 0, {}
    rows, codes = _commands(), list(ERRORS)
    for generator in batch.generators():
        for _ in range(_MESSAGES_A_RUN):
            row = rows[int(generator.integers(len(rows)))]
            code = codes[int(generator.integers(len(codes)))]
            message = JointMessage.of(_good(row, generator))
            words = ERRORS[code](generator, row, message, _NOW_NS)
            total += 1
            try:
                unpack(row.name, message.serialized(), _NOW_NS)
                outcome = "accepted"
            except Refusal as refusal:
                if refusal.code is code and words in refusal.reason:
                    continue
                outcome = f"{refusal.code}: {refusal.reason}"
            missed += 1
            details[f"{row.name}, {code.value} ({words})"] = outcome
    return Measured(missed, f"of {total} invalid commands", details)


_BAD_VALUES: tuple[object, ...] = (
    math.nan, math.inf, -math.inf, -1.0, "three", True, None, [], {}, 1e30,
)  # fmt: skip
# Fields for which one of the values is valid.
_ALLOWED: dict[str, tuple[object, ...]] = {
    "tether.breaking_load": (math.inf, 1e30),
    "start.theta0": (-1.0,),
}
_PATHS = (
    "gravity", "tether.length", "tether.elements", "tether.youngs_modulus", "tether.radius",
    "tether.density", "tether.axial_damping_time", "rover.m1", "rover.m2", "rover.spring_rate",
    "rover.spring_free_length", "rover.body1_size", "start.slack", "start.drop",
    "take_off.compression", "integration.h", "integration.tolerance", "start.geometry",
    "start.initial_shape", "tether.breaking_load", "start.theta0", "tether.elemnts", "rovr.m1",
)  # fmt: skip


def bad_scenarios(_batch: CheckBatch) -> Measured:
    """Number of invalid scenario values not refused with their path and value."""
    missed, total, details = 0, 0, {}
    for path in _PATHS:
        for value in _BAD_VALUES:
            if any(value is good or value == good for good in _ALLOWED.get(path, ())):
                continue
            # Stiffness and density have no upper bound; null omits one definition.
            if value == 1e30 and path in {
                "tether.youngs_modulus", "tether.density", "rover.spring_rate",
            }:  # fmt: skip
                continue
            total += 1
            try:
                load_scenario("paper_table1_high", {path: value})
            except ScenarioError as error:
                if path.rpartition(".")[2] in str(error) or path.partition(".")[0] in str(error):
                    continue
                details[f"{path} = {value}"] = str(error)
            else:
                details[f"{path} = {value}"] = "accepted"
            missed += 1
    return Measured(missed, f"of {total} invalid values", details)


def broken_scenario_files(batch: CheckBatch) -> Measured:
    """Number of randomly damaged scenario files that raise anything but a refusal."""
    bad, refused, details = 0, 0, {}
    texts = {
        name: resources.files("rover_sim.scenarios") / f"{name}.yaml" for name in list_scenarios()
    }
    path = batch.folder / "damaged.yaml"
    total = 0
    for generator in batch.generators():
        for name, source in texts.items():
            data = bytearray(source.read_bytes())
            for _ in range(int(generator.integers(1, 6))):
                data[int(generator.integers(len(data)))] = int(generator.integers(256))
            if generator.random() < 0.3:
                data = data[: int(generator.integers(1, len(data)))]
            elif generator.random() < 0.5:
                data = bytearray(byte if byte < 128 else byte - 96 for byte in data)
            path.write_bytes(bytes(data))
            total += 1
            try:
                load_scenario(path)
            except ScenarioError:
                refused += 1
            except Exception as error:  # noqa: BLE001 - that is what is looked for
                bad += 1
                details[f"{name}: {type(error).__name__}"] = str(error)[:120]
    return Measured(bad, f"of {total} damaged files; {refused} refused", details)
