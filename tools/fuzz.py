"""Explore the tests marked `fuzz` by coverage, and keep the inputs that reach new code.

    python tools/fuzz.py --minutes 10 [-k WORD]

Each test gets the same time. Its new inputs go into a folder of out/fuzz, some of them into
test/corpus, which `make test` repeats. An input that breaks the test, takes more than 20 s or
2 GB is kept there and fails it until it is mended. Needs atheris (the extra `fuzz`).
"""

from __future__ import annotations

import argparse
import random
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "test" / "support")]

from fuzz_targets import folder_of, load_target  # noqa: E402

LARGEST = 4096  # of an input [B]
LONGEST = 20  # of an input [s]
MEMORY = 2048  # [MB]
KEPT = 16  # inputs of a target
SEEDS = 8  # random inputs to begin with
# Whole packages; without rover_sim, whose kernels are compiled from their bytecode.
_INSTRUMENTED = (
    "canopen", "mcap", "msg_schemas", "operator_console", "rover_bags", "rover_control",
    "rover_estimation", "rover_hil", "rover_launch", "rover_runtime", "rover_studies",
    "rover_validation", "tether_winch",
)  # fmt: skip


def marked_tests(word: str) -> list[str]:
    """Return the marked tests whose names contain a word, as pytest names them."""
    files = [
        str(path) for path in (ROOT / "test").rglob("test_*.py")
        if "mark.fuzz" in path.read_text(encoding="utf-8")
    ]  # fmt: skip
    command = [sys.executable, "-m", "pytest", "-m", "fuzz", "-k", word, "--collect-only", "-q"]
    command += files
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    return sorted(line for line in done.stdout.splitlines() if "::" in line)


def explore(folder: Path, options: Sequence[str]) -> None:
    """Run the fuzzer in this process, which it ends."""
    import atheris  # noqa: PLC0415 - only here is it needed
    from hypothesis import settings  # noqa: PLC0415

    settings.register_profile("fuzz", deadline=None, database=None)
    settings.load_profile("fuzz")
    with atheris.instrument_imports(include=list(_INSTRUMENTED)):
        target = load_target(folder)
    target(random.Random(0).randbytes(LARGEST))  # compiles kernels, which takes its time once
    atheris.Setup([str(folder), *options], target)
    atheris.Fuzz()


def fuzz(node: str, seconds: float) -> tuple[bool, str]:
    """Explore one test; returns whether nothing broke, and a line that describes the run."""
    kept = folder_of(node)
    found = ROOT / "out" / "fuzz" / kept.name
    for folder in (kept, found):
        folder.mkdir(parents=True, exist_ok=True)
    if not any(kept.iterdir()) and not any(found.iterdir()):
        # Too few bytes give hypothesis nothing to draw from.
        for number in range(SEEDS):
            seed = random.Random(number).randbytes(LARGEST // SEEDS * (number + 1))
            (found / f"seed-{number}").write_bytes(seed)
    limits = (
        "-len_control=0",
        f"-max_len={LARGEST}",
        f"-timeout={LONGEST}",
        f"-rss_limit_mb={MEMORY}",
    )
    run = [
        sys.executable, __file__, "--explore", str(kept), str(found), str(kept), *limits,
        f"-max_total_time={seconds:.0f}",
        "-print_final_stats=1", f"-artifact_prefix={kept}/",
    ]  # fmt: skip
    done = subprocess.run(run, cwd=ROOT, capture_output=True, text=True, errors="replace",
                          check=False)  # fmt: skip
    if done.returncode != 0:
        print(done.stdout[-4000:], done.stderr[-4000:], sep="\n")
    count = re.search(r"number_of_executed_units: (\d+)", done.stderr)
    covered = re.findall(r"cov: (\d+)", done.stderr)
    _keep_some(kept, found)
    line = (
        f"{kept.name}: {count.group(1) if count else 'no'} inputs, "
        f"{covered[-1] if covered else 'no'} places covered, {len(list(kept.iterdir()))} kept"
    )
    return done.returncode == 0, line


def _keep_some(kept: Path, found: Path) -> None:
    """Keep inputs of all sizes, each of which reached new code, and those that broke something."""
    broken = ("crash-", "timeout-", "oom-")
    usual = [file for file in kept.iterdir() if not file.name.startswith(broken)]
    for file in usual:
        file.replace(found / file.name)
    every = sorted(found.iterdir(), key=lambda file: (file.stat().st_size, file.name))
    for file in every[:: max(1, -(-len(every) // KEPT))]:
        shutil.copy(file, kept / file.name)


def main(arguments: Sequence[str]) -> int:
    """Explore the targets; returns 1 if an input broke one."""
    if arguments[:1] == ["--explore"]:
        explore(Path(arguments[1]), arguments[2:])
        return 0
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="in all (default: %(default)g)")
    parser.add_argument("-k", dest="word", default="", metavar="WORD", help="of the tests' names")
    options = parser.parse_args(arguments)
    nodes = marked_tests(options.word)
    if not nodes:
        parser.error(f"no marked test has {options.word!r} in its name")
    sound = True
    for node in nodes:
        is_sound, line = fuzz(node, 60.0 * options.minutes / len(nodes))
        print("ok    " if is_sound else "BROKEN", line, flush=True)
        sound &= is_sound
    return 0 if sound else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
