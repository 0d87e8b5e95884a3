"""``paper_study``: the source paper's study of the tethered jump, one point of it or the whole.

    paper_study --scenario paper_table1_high --geometry=+K --slack 2 --elements 20 --json
    paper_study --all --out out/study

The whole study makes figures 11 to 16 for every geometry, starting shape and mesh that the paper's
text leaves open, and tells for each of the paper's claims where it holds. Killed or interrupted,
the same command goes on where it was.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from rover_studies import paper_point


def main(arguments: Sequence[str] | None = None) -> int:
    """The executable ``paper_study``; returns the exit status."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if "--all" not in given:
        return paper_point.main(given)
    # Its tables need libraries that a single point does without.
    from rover_studies import whole_study  # noqa: PLC0415

    return whole_study.main(given)


if __name__ == "__main__":
    sys.exit(main())
