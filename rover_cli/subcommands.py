"""Table of the subcommands of `mother_rover`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Subcommand:
    """One subcommand and the module that implements it.

    The module defines ``add_arguments(parser)`` and ``run(options) -> int``. ``add_arguments`` may
    set the parser's description, epilog and formatter. ``options`` also holds ``ros_arguments``,
    the words from ``--ros-args`` on, and ``usage_error(message)``, which ends the process with
    exit code 2. ``normalize_arguments(words)``, if the module defines it, rewrites the words before
    they are parsed.

    Attributes:
        path: words that select it.
        module: dotted name of the implementing module.
        summary: one line for the help of the level above.
        is_node: whether it accepts ``--ros-args``.
    """

    path: tuple[str, ...]
    module: str
    summary: str
    is_node: bool = False


GROUPS = {
    ("study",): "reproduce the source paper's study of the tethered jump",
    ("bag",): "record, report, compare, export, recover, re-simulate and identify from bags",
    ("state",): "states of a simulated plant, from which another run starts",
    ("hil",): "test the interface to drives and sensors, emulated or real",
    ("validate",): "identify the plant's laws from measurements and predict others",
    ("validate", "cable"): "compare the tether with the measured motion of a cable",
    ("validate", "wheel"): "compare the wheel-soil law with a measured wheel on sand",
}
"""Summary of every word, or words, that select several subcommands; outer groups first."""

SUBCOMMANDS = (
    Subcommand(("demo",), "rover_verify.demo.demo", "simulate a mission or a jump and report it"),
    Subcommand(
        ("compile",), "rover_sim.plants.compile_command", "compile the plants for later starts"
    ),
    Subcommand(("run",), "rover_cli.run_node", "start one ROS 2 node, as `ros2 run` does"),
    Subcommand(
        ("bag", "record"),
        "rover_bags.recording.record",
        "record the suite's topics into a bag",
        is_node=True,
    ),
    Subcommand(
        ("bag", "report"), "rover_bags.views.report", "report metrics, plots and audits of one bag"
    ),
    Subcommand(("bag", "compare"), "rover_bags.views.compare", "compare several bags"),
    Subcommand(("bag", "export"), "rover_bags.views.export", "write a bag as Parquet or CSV"),
    Subcommand(
        ("bag", "recover"),
        "rover_bags.files.recover",
        "make a valid bag of a truncated or damaged one",
    ),
    Subcommand(
        ("bag", "resim"),
        "rover_bags.resimulation.resim",
        "simulate a recorded run again and compare it",
    ),
    Subcommand(
        ("bag", "state"),
        "rover_bags.resimulation.bag_state",
        "save the plant's state at a time of a bag, to start from it",
    ),
    Subcommand(
        ("state", "save"),
        "rover_bags.recording.state_saving",
        "save the state of a running simulated plant, to start from it",
        is_node=True,
    ),
    Subcommand(
        ("bag", "identify"),
        "rover_bags.identification.identify",
        "estimate machine parameters from bags",
    ),
    Subcommand(
        ("bag", "example"), "rover_verify.harness.scripted_bag", "write a bag of a scripted mission"
    ),
    Subcommand(
        ("hil", "check"),
        "rover_hil.rehearsal.interface_check",
        "run the interface check of the package",
        is_node=True,
    ),
    Subcommand(
        ("hil", "rehearse"),
        "rover_hil.rehearsal.rehearsal_node",
        "run a test procedure and leave a record",
        is_node=True,
    ),
    Subcommand(
        ("hil", "dictionary"),
        "rover_hil.canopen.dictionary",
        "write the CANopen object dictionaries, or compare one",
    ),
    Subcommand(
        ("sweep",), "rover_studies.sweep.sweep", "run a parameter grid or a Monte Carlo plan"
    ),
    Subcommand(
        ("study", "all"),
        "rover_studies.paper.whole_study",
        "reproduce figures 11 to 16 of the paper",
    ),
    Subcommand(
        ("study", "point"), "rover_studies.paper.paper_point", "simulate one jump of the study"
    ),
    Subcommand(
        ("validate", "cable", "identify"),
        "rover_validation.cable.identify",
        "identify a cable's laws from takes of its motion",
    ),
    Subcommand(
        ("validate", "cable", "predict"),
        "rover_validation.cable.predict",
        "predict takes of a cable from their first two frames",
    ),
    Subcommand(
        ("validate", "cable", "scenario"),
        "rover_validation.cable.scenario",
        "write a scenario with an identified cable as its tether",
    ),
    Subcommand(
        ("validate", "cable", "report"),
        "rover_validation.cable.report",
        "draw measured over predicted takes of a cable",
    ),
    Subcommand(
        ("validate", "cable", "example"),
        "rover_validation.cable.example",
        "write takes of a simulated cable",
    ),
    Subcommand(
        ("validate", "summary"),
        "rover_validation.sets.summary",
        "summarise what the laws predict of a folder of measured sets",
    ),
    Subcommand(
        ("validate", "page"),
        "rover_verify.requirements.validation_page",
        "write the results in docs/validation.md",
    ),
    Subcommand(("verify",), "rover_verify.requirements.matrix", "measure every requirement"),
    Subcommand(("bench",), "rover_verify.bench.bench", "measure speed and error against Exudyn"),
    Subcommand(("contract",), "msg_schemas.document", "write docs/contract.md"),
    Subcommand(
        ("policy",), "msg_schemas.access_policy", "write the SROS 2 access policy of the nodes"
    ),
    Subcommand(
        ("requirements",), "rover_verify.requirements.requirements", "write docs/requirements.md"
    ),
    Subcommand(
        ("validate", "wheel", "identify"),
        "rover_validation.wheel.identify",
        "identify the soil of a measured wheel",
    ),
    Subcommand(
        ("validate", "wheel", "predict"),
        "rover_validation.wheel.predict",
        "predict forces and sinkage of a wheel on an identified soil",
    ),
    Subcommand(
        ("validate", "wheel", "report"),
        "rover_validation.wheel.report",
        "compare measured runs of a wheel with predictions",
    ),
    Subcommand(
        ("validate", "wheel", "example"),
        "rover_validation.wheel.example",
        "write a small made-up set of a soil bin",
    ),
    Subcommand(("picture",), "rover_bags.views.picture", "draw a bag as an animated picture"),
)


def find_subcommand(words: Sequence[str]) -> Subcommand | None:
    """Return the subcommand that the first words select, None without one."""
    for subcommand in SUBCOMMANDS:
        if tuple(words[: len(subcommand.path)]) == subcommand.path:
            return subcommand
    return None
