"""`mother_rover demo`: a whole mission or one jump, flown by the nodes, with a report."""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tqdm import tqdm

from msg_schemas.number_arguments import seed
from msg_schemas.regular_files import writing_problem
from rover_sim.plants.compile_command import compile_with_progress
from rover_verify.demo import jump_show, mission_show
from rover_verify.demo.show import ShowError
from rover_verify.harness import clean_shared_memory

MISSION, JUMP = "mission", "jump"
_SCENARIOS = {MISSION: mission_show.SCENARIO, JUMP: jump_show.SCENARIO}
_SUMMARY = {MISSION: mission_show.summary, JUMP: jump_show.summary}


def _replace(target: Path, made: Path) -> None:
    """Replace a folder by a finished one; one of the two always exists."""
    old = target.with_name(f".{target.name}.old.{os.getpid()}")
    if target.exists():
        target.rename(old)
    made.rename(target)
    shutil.rmtree(old, ignore_errors=True)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = (
        "Simulate a whole mission or one jump with the nodes, check it and write a report with "
        "plots, an animation and a bag."
    )
    parser.epilog = (
        "Exit codes: 0 every check passed, 1 a check failed, 2 it could not run, 130 interrupted."
    )
    parser.add_argument(
        "what", nargs="?", choices=(MISSION, JUMP), default=MISSION,
        help="mission: down the Marius Hills Hole and back; jump: one jump, compared with an "
        "independent code (default: mission)",
    )  # fmt: skip
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        default=Path("out/demo"),
        help="folder of the report, replaced when done (default: %(default)s)",
    )
    parser.add_argument(
        "--seed", type=seed, default=1, metavar="N",
        help="random seed of the mission's sensor errors (default: %(default)d)",
    )  # fmt: skip
    parser.add_argument(
        "--real-time-factor", type=float, default=1.0, metavar="X",
        help="real-time factor of the jump, 0.1 .. 10 (default: %(default)g); the mission runs as "
        "fast as the machine allows",
    )  # fmt: skip


def run(options: argparse.Namespace) -> int:
    """Simulate the mission or the jump, and write the report.

    Returns:
        0 every check passed, 1 a check failed, 2 it could not run, 130 interrupted.
    """
    factor = options.real_time_factor
    if not 0.1 <= factor <= 10.0:
        options.usage_error(f"--real-time-factor {factor}: must be 0.1 .. 10")
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not domain.isdecimal():
        options.usage_error(f"ROS_DOMAIN_ID is {domain!r}: must be a whole number")
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    target = Path(os.path.realpath(options.out))  # also of links in a circle
    if target.exists() and not (target / "metrics.json").exists() and any(target.iterdir()):
        print(
            f"mother_rover demo: {target} is not the folder of a demo; choose another folder",
            file=sys.stderr,
        )
        return 2
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
        made.chmod(0o755)
    except OSError as error:
        print(f"mother_rover demo: {writing_problem(error, target.parent)}", file=sys.stderr)
        return 2
    quiet = not sys.stderr.isatty()
    try:
        compile_with_progress(_SCENARIOS[options.what])
        if options.what == MISSION:
            metrics = mission_show.show_mission(
                made,
                domain=int(domain),
                seed=options.seed,
                quiet=quiet,
                announce=tqdm.write,
            )
        else:
            metrics = jump_show.show_jump(made, factor, quiet=quiet)
        _replace(target, made)
    except (ShowError, AssertionError) as error:
        print(f"mother_rover demo: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as stop:
        print(f"\nmother_rover demo: stopped by {stop}; all processes have ended", file=sys.stderr)
        return 130
    finally:
        shutil.rmtree(made, ignore_errors=True)
        clean_shared_memory()
    _print_result(target, metrics, _SUMMARY[options.what](metrics))
    return 0 if metrics["pass"] else 1


def _print_result(folder: Path, metrics: Mapping[str, Any], what: str) -> None:
    print(f"\n{what}\n")
    for item in metrics["verdict"]:
        print(f"  {'PASS' if item['pass'] else 'FAIL'}  {item['text']}")
    print(f"\n{'All checks passed.' if metrics['pass'] else 'A check FAILED.'}  Files:")
    for name, description in (
        ("report.html", "the report: open it in a browser"),
        ("animation.gif", "animation of rover and tether"),
        ("metrics.json", "the numbers"),
        ("bag", "the recorded bag (MCAP)"),
    ):
        if (folder / name).exists():
            print(f"  {folder / name}  {description}")
    print(
        "Look at the bag again with\n"
        f"  rover status --bag {folder / 'bag'} --at 60\n"
        f"  mother_rover run operator_console --ros-args -p bag_folder:={folder}"
    )
