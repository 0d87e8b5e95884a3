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
        "Run the package's interface check against the machine behind hil_bridge (rates, latency, "
        "limits, safe reactions) and write a record for sign-off. No step that may move the "
        "machine runs before the operator confirms motion."
    )
    parser.epilog = rehearsal_node.EXIT_CODES


run = rehearsal_node.run
