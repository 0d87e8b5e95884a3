"""Write what is sent on the loop host into a bag, with messages as published over DDS."""

from __future__ import annotations

from pathlib import Path

from msg_schemas.cdr import pack
from msg_schemas.samples import Sample
from msg_schemas.table import TOPICS
from rover_bags.files.store import BagWriter, standard_type

_EPOCH_NS = 1_790_000_000_000_000_000
_DELAY_NS = 300_000  # from publication to reception


class Tape:
    """A bag of an in-process simulation.

    Args:
        path: the bag's folder, which must not exist.
    """

    def __init__(self, path: Path) -> None:
        self._writer = BagWriter(path, sync=False, chunk_period=1e9)
        self._channels: dict[str, int] = {}

    def write(self, name: str, sample: Sample, sender: str, stamp_ns: int) -> None:
        """Write one sample, as the loop host passes it to a listener.

        Args:
            name: of the topic.
            sample: that was sent.
            sender: text of ``header.frame_id`` where it is not empty.
            stamp_ns: simulated time of sending [ns].
        """
        full = name if name.startswith("/") else f"/{name}"
        if full not in self._channels:
            kind = standard_type(TOPICS[name].message)
            self._channels[full] = self._writer.add_topic(full, kind)
        sent, data = _EPOCH_NS + stamp_ns, pack(name, sample, sender)
        self._writer.write(self._channels[full], sent + _DELAY_NS, sent, data)

    def close(self) -> None:
        """Close the bag."""
        self._writer.close()

    def discard(self) -> None:
        """Remove the bag, after an error."""
        self._writer.discard()
