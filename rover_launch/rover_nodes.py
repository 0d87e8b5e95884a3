"""The ``rover_nodes`` executable: the controllers of the rover in one process."""

from __future__ import annotations

import sys

from rover_launch.composed import run_composed


def main() -> int:
    """Run the nodes."""
    return run_composed("rover_nodes")


if __name__ == "__main__":
    sys.exit(main())
