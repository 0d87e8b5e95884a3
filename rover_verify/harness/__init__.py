"""Test harness: processes and observers in a separate ROS domain."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from rover_runtime.stop_signals import deferred_stop_signals
from rover_verify.harness.observer import Observer
from rover_verify.harness.processes import Process, Processes, clean_shared_memory
from rover_verify.harness.ros_domain import multicast_link, reserved_domain

__all__ = ["NodeHarness", "Observer", "Process", "Processes", "clean_shared_memory", "open_harness"]


class NodeHarness:
    """Processes and observers in one domain; closing it stops them all.

    Attributes:
        domain: ROS domain identifier.
        link: value of `hil_bridge`'s parameter `link`, unique to this harness.
    """

    def __init__(self, domain: int, folder: Path, closing: ExitStack) -> None:
        self.domain = domain
        self.link = multicast_link(domain)
        self.processes = Processes(domain, folder)
        self._closing = closing
        closing.callback(self.processes.end)

    def observer(self, namespace: str = "", remap: Mapping[str, str] | None = None) -> Observer:
        """Return a new observer in this domain, closed with the harness."""
        with deferred_stop_signals():
            made = Observer(self.domain, namespace, remap)
            self._closing.callback(made.close)
        return made


@contextmanager
def open_harness(folder: Path, domain: int | None = None) -> Iterator[NodeHarness]:
    """Open a harness; its processes run in ``folder``.

    Args:
        folder: of the processes.
        domain: ROS domain; None = a reserved one.
    """
    with ExitStack() as closing:
        chosen = closing.enter_context(reserved_domain()) if domain is None else domain
        yield NodeHarness(chosen, folder, closing)
