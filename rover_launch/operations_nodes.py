"""The ``operations_nodes`` executable: the supervisor of missions in one process."""

from __future__ import annotations

import sys

from rover_launch.composed import run_composed


def main() -> int:
    """Run the nodes."""
    return run_composed("operations_nodes")


if __name__ == "__main__":
    sys.exit(main())
