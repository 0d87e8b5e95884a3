"""The end of a process whose nodes fail or block."""

from __future__ import annotations

import signal
import subprocess
import sys
from unittest.mock import Mock

import pytest

from rover_runtime.ros.process import _SHUTDOWN_TIMEOUT, _end


@pytest.mark.ros
def test_a_node_that_fails_keeps_no_other_from_its_safe_end(monkeypatch: pytest.MonkeyPatch):
    # It would end this process: its end is not that of the nodes.
    monkeypatch.setattr("faulthandler.dump_traceback_later", Mock())
    nodes = [Mock(), Mock(), Mock()]
    nodes[0].deactivate_and_report.side_effect = OSError("no stop")
    nodes[1].release_resources.side_effect = OSError("no release")
    carrier, executor = Mock(), Mock()
    with pytest.raises(OSError, match="no stop"):
        _end(nodes, carrier, executor)
    for node in nodes:
        node.deactivate_and_report.assert_called_once_with()
        node.release_resources.assert_called_once_with()
        node.destroy_node.assert_called_once_with()
    carrier.leave.assert_called_once_with(executor)
    executor.shutdown.assert_called_once_with()


@pytest.mark.ros
def test_each_component_has_its_own_time_to_stop_and_to_release(monkeypatch: pytest.MonkeyPatch):
    """A rehearsal disarms the drives and closes its bag when it stops."""
    steps = Mock()
    monkeypatch.setattr("faulthandler.dump_traceback_later", steps.limit)
    nodes = [steps.first, steps.second]
    steps.first.component.END_TIMEOUT, steps.second.component.END_TIMEOUT = 900.0, 30.0
    _end(nodes, steps.carrier, steps.executor)
    done = [given[0] if name == "limit" else name for name, given, _ in steps.mock_calls]
    assert done == [
        900.0, "first.deactivate_and_report",
        30.0, "second.deactivate_and_report",
        _SHUTDOWN_TIMEOUT, "carrier.leave", "executor.context.ok",
        "executor.spin_until_future_complete", "executor.shutdown",
        900.0, "first.release_resources",
        30.0, "second.release_resources",
        _SHUTDOWN_TIMEOUT, "first.destroy_node", "second.destroy_node",
    ]  # fmt: skip


@pytest.mark.ros
@pytest.mark.parametrize(
    ("after", "code", "output"),
    [
        ("pass", 1, "most recent call first"),
        # As when the interpreter has ended, and its watch with it.
        ("faulthandler.cancel_dump_traceback_later()", -signal.SIGALRM, ""),
    ],
)
def test_a_process_that_blocks_after_its_nodes_have_ended_is_ended(
    after: str, code: int, output: str
):
    script = f"""
import faulthandler, threading
from rover_runtime.ros import process
process._SHUTDOWN_TIMEOUT = 0.5
process.run(arguments=["nonsense"])
{after}
threading.Event().wait()
"""
    ended = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60.0, check=False
    )
    assert ended.returncode == code
    assert output in ended.stderr
