"""The paper's study: what it concludes from its own runs."""

from __future__ import annotations

from rover_studies.paper.paper_plan import HEAVY, LIGHT, QUICK, Extent
from rover_studies.paper.whole_study import evaluate, make_runs
from rover_verify.checks import CheckBatch, Measured

_SCATTER_CLAIMS = ("height beyond 1.5", "scatter beyond 1.5")


def verdict(batch: CheckBatch) -> Measured:
    """How many conclusions about the scatter of figures 13 and 14 the study does not draw."""
    extent = Extent(QUICK.slacks, QUICK.elements, (HEAVY, LIGHT), QUICK.geometries)
    rows = make_runs(extent, batch.folder / "runs", workers=2, show_progress=False)
    cause, results = evaluate(rows, batch.folder / "study")
    missed = [words for words, holds in cause.conditions if not holds]
    missed += [v.summary for v in results if v.claim.name in _SCATTER_CLAIMS and not v.artefact]
    details: dict[str, float | str] = {v.claim.name: v.summary for v in results}
    details |= {f"missed {index}": words for index, words in enumerate(missed, 1)}
    conclusions = len(cause.conditions) + len(_SCATTER_CLAIMS)
    jumps = sum(len(table) for table in rows.values())
    return Measured(len(missed), f"of {conclusions} conclusions from {jumps} jumps", details)
