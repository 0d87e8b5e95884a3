"""The ``mother_nodes`` executable: the controllers of the mother machine in one process."""

from __future__ import annotations

import sys

from rover_launch.composed import run_composed


def main() -> int:
    """Run the nodes."""
    return run_composed("mother_nodes")


if __name__ == "__main__":
    sys.exit(main())
