"""`mother_rover compile`: compile the plants for all later starts."""

from __future__ import annotations

import argparse
import sys
import time

from rover_sim.plants.ahead_of_time import compile_ahead
from rover_sim.scenarios.scenario import load_scenario

_SCENARIOS = {"planar": "paper_table1_high", "spatial": "free_hang"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the models."""
    parser.description = (
        "Compile the plants and keep the code for all later starts on this machine. It takes a "
        "minute or more after an installation or a change of the physics, else nothing."
    )
    parser.epilog = "Exit codes: 0 compiled, 1 the code cannot be kept: every start compiles."
    names = " or ".join(_SCENARIOS)
    parser.add_argument(
        "models", nargs="*", type=_model, metavar="MODEL", help=f"{names} (default: both)"
    )


def _model(text: str) -> str:
    if text not in _SCENARIOS:
        msg = f"{text!r} is no model; it must be {' or '.join(_SCENARIOS)}"
        raise argparse.ArgumentTypeError(msg)
    return text


def run(options: argparse.Namespace) -> int:
    """Run the command.

    Returns:
        0 compiled, 1 the code cannot be kept.
    """
    code = 0
    for model in options.models or _SCENARIOS:
        begin = time.monotonic()
        if compile_with_progress(_SCENARIOS[model]):
            print(f"the {model} plant is compiled ({time.monotonic() - begin:.1f} s)", flush=True)
        else:
            code = 1
            print(f"the code of the {model} plant cannot be kept", file=sys.stderr)
    return code


def compile_with_progress(scenario: str) -> bool:
    """Compile the model of a shipped scenario and print the progress; as `compile_ahead`."""
    loaded = load_scenario(scenario)
    return compile_ahead(
        loaded,
        progress=lambda duration, count: print(
            f"compiling the {loaded.model} plant for {duration:.0f} s, {count} functions done",
            flush=True,
        ),
    )
