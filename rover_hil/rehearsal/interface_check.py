"""`mother_rover hil check`: runs the package's procedure `interface_check`."""

from __future__ import annotations

import argparse

from rover_hil.rehearsal import rehearsal_node

_PROCEDURE = "interface_check"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    rehearsal_node.add_run_arguments(parser)
    parser.set_defaults(procedure=_PROCEDURE)
    parser.description = (
        "Run the package's interface check against the machine behind hil_bridge: signals, units, "
        "limits and safe reactions, with a record for signature. Nothing moves before motion is "
        "confirmed."
    )
    parser.epilog = rehearsal_node.EXIT_CODES


run = rehearsal_node.run
