"""Write a bag of an in-process simulation, with samples as published over DDS."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from rclpy.serialization import serialize_message

from msg_schemas.codecs import encode
from msg_schemas.samples import Sample
from msg_schemas.table import TOPICS
from rover_bags.files.store import BagWriter, standard_type
from rover_sim.plant_interface import PlantInterface
from rover_sim.sim_loop import Schedule

_EPOCH_NS = 1_790_000_000_000_000_000
_DELAY_NS = 300_000  # from publication to reception


class Tape:
    """A bag of an in-process simulation.

    Args:
        path: the bag's folder, which must not exist.
        rate_limit: largest rate of the plant's topics [Hz].
    """

    def __init__(self, path: Path, rate_limit: float = 100.0) -> None:
        self._writer = BagWriter(path, sync=False, chunk_period=1e9)
        self._channels: dict[str, int] = {}
        self._rate_limit = rate_limit
        self._schedule: Schedule | None = None
        self._ticked_ns = 0
        self._phase = ""

    def write(self, name: str, sample: Sample, stamp_ns: int) -> None:
        """Write one sample, published at a simulated time [ns]."""
        full = name if name.startswith("/") else f"/{name}"
        if full not in self._channels:
            kind = standard_type(TOPICS[name].message)
            self._channels[full] = self._writer.add_topic(full, kind)
        sent = _EPOCH_NS + stamp_ns
        data = bytes(serialize_message(encode(name, sample)))
        self._writer.write(self._channels[full], sent + _DELAY_NS, sent, data)

    def tick(
        self, interface: PlantInterface[Any], known: Mapping[str, Sample], stamp_ns: int
    ) -> None:
        """Write the topics of a plant that are due after a tick.

        Args:
            interface: interface of the plant, after its measurement.
            known: samples that exist already, by topic.
            stamp_ns: end of the tick [ns].
        """
        if self._schedule is None:
            self._schedule = Schedule(self._rates(interface.topics))
        due = self._schedule.due(self._ticked_ns, stamp_ns)
        self._ticked_ns = stamp_ns
        missing = [name for name in due if name not in known]
        for name, sample in interface.samples(missing):
            self.write(name, sample, stamp_ns)
        for name in due:
            if name in known:
                self.write(name, known[name], stamp_ns)

    def _rates(self, names: Iterable[str]) -> dict[str, float]:
        rates = {name: TOPICS[name].rate for name in names}
        return {
            name: min(rate, self._rate_limit) for name, rate in rates.items() if rate is not None
        }

    def close(self) -> None:
        """Close the bag."""
        self._writer.close()
