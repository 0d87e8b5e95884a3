"""Files of a plant's state, as the commands that save one write them."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from msg_schemas.regular_files import writing_problem
from rover_sim import STAMP, write_state

_NANO: Final = 1e9


def save_state(
    command: str, path: Path, scenario: Mapping[str, Any], message: Mapping[str, Any]
) -> bool:
    """Write a new file and print its time; where that fails, print why and return False.

    Args:
        command: that saves, for the message.
        path: of the file.
        scenario: of the plant.
        message: content of ``truth/state``.
    """
    try:
        write_state(path, scenario, message)
    except OSError as error:
        print(f"{command}: {writing_problem(error, path)}", file=sys.stderr)
        return False
    print(f"{path}: state at {message[STAMP] / _NANO:.3f} s of simulated time")
    return True
