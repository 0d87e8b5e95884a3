"""The end of a process whose nodes fail."""

from __future__ import annotations

from unittest.mock import Mock

import pytest

from rover_runtime.ros.process import _end


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
