"""Run the command from a source tree: `python -m rover_cli`."""

from __future__ import annotations

import sys

from rover_cli.command_line import main

if __name__ == "__main__":
    sys.exit(main())
