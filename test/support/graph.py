"""What a node subscribes to, seen from outside."""

from __future__ import annotations

from msg_schemas.access import TRUTH_BATCHES
from msg_schemas.specifications import Audience
from msg_schemas.table import TOPICS
from rover_verify.harness import Observer


def subscriptions_of(observer: Observer, node_name: str, last: str | None = None) -> set[str]:
    """Names of the topics that a running node subscribes to, relative to its namespace.

    They become known one after the other: ``last`` is the topic that the node subscribes to last.
    """
    found: list[tuple[str, list[str]]] = []

    def look() -> bool:
        found[:] = observer.node.get_subscriber_names_and_types_by_node(node_name, "/")
        return any(last is None or name == f"/{last}" for name, _ in found)

    observer.wait_until(look, f"{node_name} does not subscribe to {last or 'anything'}")
    return {name.removeprefix("/") for name, _ in found}


def forbidden_to_controllers() -> set[str]:
    """Topics that no controller may read."""
    forbidden = {n for n, row in TOPICS.items() if row.audience is Audience.NOT_CONTROLLERS}
    return forbidden | {TRUTH_BATCHES}
