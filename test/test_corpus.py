"""Inputs that a fuzzer has found hold what the tests say of every input."""

from __future__ import annotations

from pathlib import Path

import pytest
from fuzz_targets import CORPUS, load_target

KEPT = sorted(folder for folder in CORPUS.glob("*") if folder.is_dir())


@pytest.mark.parametrize("folder", KEPT, ids=lambda folder: folder.name)
def test_the_kept_inputs_of_a_target_break_nothing(folder: Path):
    target, files = load_target(folder), sorted(folder.iterdir())
    assert files
    for file in files:
        target(file.read_bytes())
