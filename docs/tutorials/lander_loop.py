"""Lands the rover with the lander, the winch and the simulated plant in one thread, without ROS."""

from pathlib import Path

from lander import LanderEvent, LanderNode

from msg_schemas import topics
from msg_schemas.samples import Sample
from rover_runtime.loop_host import LoopHost
from rover_sim.node.sim_node import SimNode
from tether_winch.winch_node import WinchNode

PIT = Path(__file__).parent / "shallow_pit.yaml"
events: list[str] = []


def listen(_topic: str, sample: Sample, _sender: str, _now_ns: int) -> None:
    """Collect the names of all events."""
    events.extend(status.name for status in sample.statuses)  # type: ignore[union-attr]


host = LoopHost()
host.exchange.listen(listen, topics.EVENTS)
host.start(SimNode, {"scenario": str(PIT)})
host.start(WinchNode)
host.start(LanderNode)
host.run(1.0)
host.call(topics.WINCH_REARM)
landed = host.run(60.0, until=lambda: LanderEvent.LANDED in events)
print(f"landed: {landed}, after {host.time:.1f} s in the pit of 8 m")
