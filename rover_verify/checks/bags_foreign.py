"""Bags of other recorders, intact and randomly damaged."""

from __future__ import annotations

import shutil
from collections import Counter
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from rover_bags.files.folder import ScanError
from rover_bags.files.scan import BagScan
from rover_verify.checks import Batch, Measured
from rover_verify.harness.foreign_bags import KINDS, METADATA, Kind, Recorded, cut, messages, split

_PER_RUN = 2
_DESCRIBING = 16 * 4096
"""Bytes at a file's start that describe it; a cut within them loses everything."""
_LEADING = 0.02
"""Fraction of a file's index pages, which may lie behind the cut."""


def read(batch: Batch) -> Measured:
    """Number of bags that yield a false message, or lose messages unreported or needlessly."""
    bad, details, broken = 0, {}, Counter[str]()
    for index, generator in enumerate(batch.generators(batch.runs * _PER_RUN)):
        kind = KINDS[int(generator.integers(len(KINDS)))]
        folder = batch.folder / f"bag_{index}"
        recorded = messages(
            int(generator.integers(200, 900)), size=int(generator.integers(20, 400))
        )
        edges = np.sort(generator.integers(0, len(recorded), int(generator.integers(0, 4))))
        parts = [recorded[a:b] for a, b in zip([0, *edges], [*edges, len(recorded)], strict=True)]
        split(folder, kind, [part for part in parts if part])
        how, gone = _break(folder, generator)
        broken[how] += 1
        trouble = _judge(folder, kind, recorded, how, gone)
        if trouble:
            bad += 1
            details[f"bag {index}, {kind.name}, {how}"] = trouble
        shutil.rmtree(folder)
    note = ", ".join(f"{count} {how}" for how, count in sorted(broken.items()))
    return Measured(bad, f"of {batch.runs * _PER_RUN} bags: {note}", details)


def _break(folder: Path, generator: np.random.Generator) -> tuple[str, float]:
    """Damage a bag in one manner or not at all; return which, and the fraction a cut may lose."""
    if generator.random() < 0.5:
        if generator.random() < 0.5:
            (folder / METADATA).unlink()
        else:
            (folder / METADATA).write_bytes(generator.bytes(200))
    files = sorted(file for file in folder.iterdir() if file.name != METADATA)
    choice = int(generator.integers(3))
    if choice == 0:
        return "whole", 0.0
    if choice == 1 and len(files) > 1:
        files[int(generator.integers(len(files) - 1))].unlink()
        return "with a part missing", 0.0
    share = float(generator.uniform(0.2, 0.99))
    size = files[-1].stat().st_size
    cut(files[-1], share)
    return "cut", 1.0 - share + _DESCRIBING / size + _LEADING


def _judge(folder: Path, kind: Kind, recorded: list[Recorded], how: str, gone: float) -> str:
    """Return what is wrong with the reading of a bag; "" if nothing is."""
    whole = Counter(recorded)
    scan = BagScan(folder)
    try:
        found = Counter((m.topic.name, m.log_ns, m.data) for m in scan)
    except ScanError as error:
        return "" if how == "cut" else f"refused: {error}"
    false_messages, lost = found - whole, (whole - found).total()
    if false_messages:
        return f"{false_messages.total()} messages that were never recorded"
    if how == "whole" and lost:
        return f"{lost} messages of a whole bag not read"
    if lost and not scan.damage:
        return f"{lost} messages lost without a report"
    described = scan.information is not None
    if lost and described and sum(scan.lost.values()) != lost:
        return f"{lost} messages lost, {sum(scan.lost.values())} reported"
    plain = kind.storage is StoragePlugin.SQLITE3 and kind.mode is not CompressionMode.FILE
    most = gone * len(recorded)
    if how == "cut" and plain and lost > most:
        return f"{lost} messages lost, where the cut explains {most:.0f}"
    return ""
