"""``mother_rover bag state``: save the plant's state at a time of a bag, to start from it."""

import argparse
import json
import math
import sys
from collections.abc import Mapping
from enum import IntEnum
from pathlib import Path
from typing import Any, Final

from msg_schemas import topics
from rover_bags.files.scan import BagScan
from rover_bags.files.state_file import save_state
from rover_bags.files.store import BagError
from rover_bags.reading.read import received_messages
from rover_sim import STAMP, ScenarioError, is_state, scenario_from_mapping

_NANO: Final = 1_000_000_000


class BagStateExitCode(IntEnum):
    """Exit codes of ``mother_rover bag state``."""

    SAVED = 0
    REFUSED = 2
    NOT_WRITTEN = 3


def find_state(
    path: Path, at: float, namespace: str | None = None
) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """Return the scenario of a bag and the last state at or before a simulated time.

    Of several runs, which resets of the clock separate, that with the state nearest to the time
    counts, and the last one of those that are equally near; without a time, the last one.

    Args:
        path: of the bag.
        at: simulated time [s].
        namespace: of the rover, if the bag holds several.

    Raises:
        BagError: the bag cannot be read, or holds no such state.
    """
    scenarios: list[Mapping[str, Any]] = []
    found: tuple[int, Mapping[str, Any]] | None = None  # number of scenarios before it, state
    first: int | None = None
    requested = {topics.CONFIG, topics.TRUTH_STATE}
    for message in received_messages(BagScan(path), requested, namespace=namespace):
        content = json.loads(message.sample.text)
        if message.name == topics.TRUTH_STATE:
            if not is_state(content):
                continue  # of a foreign publisher
            first = content[STAMP] if first is None else first
            is_near = found is None or math.isinf(at) or content[STAMP] >= found[1][STAMP]
            if content[STAMP] <= at * _NANO + 0.5 and is_near:
                found = len(scenarios), content
        elif isinstance(content.get("scenario"), Mapping):
            scenarios.append(content["scenario"])
    if first is None or not scenarios:
        lacking = topics.TRUTH_STATE if first is None else f"a plant's {topics.CONFIG}"
        raise BagError(
            f"{path} does not hold {lacking}: a state can be saved only from the record of a "
            "simulated plant"
        )
    # The first scenario may have been received after its states.
    scenario = scenarios[max(found[0] - 1, 0) if found else 0]
    try:
        scenario_from_mapping(scenario)
    except ScenarioError as error:
        raise BagError(f"the scenario in {path} is not one of a plant: {error}") from error
    if found is None:
        raise BagError(
            f"the first state in {path} is that of {first / _NANO:.3f} s of simulated time, after "
            f"{at:g} s"
        )
    return scenario, found[1]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = (
        "Save the last state of the simulated plant at or before a time of a bag. A plant of the "
        "same scenario starts from the file by its parameter start_state. States are recorded at "
        "the plant's state_rate, once a second by default."
    )
    parser.epilog = (
        "Exit codes: 0 saved, 2 no bag, or it holds no state of that time, 3 the file exists or "
        "cannot be written."
    )
    parser.add_argument("bag", type=Path, help="the bag: its folder or one of its files")
    parser.add_argument("--at", type=float, default=math.inf, metavar="S",
                        help="simulated time [s] (default: the end)")  # fmt: skip
    parser.add_argument(
        "-o", "--out", type=Path, required=True, metavar="FILE", help="new file, such as hang.json"
    )
    parser.add_argument("--namespace", metavar="NS", help="of the rover, if the bag holds several")


def run(options: argparse.Namespace) -> int:
    """Run the command; return a :class:`BagStateExitCode`."""
    if math.isnan(options.at):
        options.usage_error("--at is nan: it should be a simulated time in s")
    try:
        scenario, content = find_state(options.bag, options.at, options.namespace)
    except BagError as error:
        print(f"mother_rover bag state: {error}", file=sys.stderr)
        return BagStateExitCode.REFUSED
    is_saved = save_state("mother_rover bag state", options.out, scenario, content)
    return BagStateExitCode.SAVED if is_saved else BagStateExitCode.NOT_WRITTEN
