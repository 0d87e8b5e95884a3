"""Keeps what rclpy's own callbacks raise from ending the process.

rclpy itself serves the parameters and the life cycle of a node, and follows the clock. Some of its
callbacks raise on messages that anyone can send: a time before 0, an unknown type of a parameter,
a transition that the present state does not have.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Any

from msg_schemas.refusal import Refusal, RefusalCode

if TYPE_CHECKING:
    from rclpy.node import Node

_OWN_PACKAGE = __name__.partition(".")[0]


def guard_foreign_callbacks(node: Node, refuse: Callable[[Refusal], object]) -> None:
    """Catch what the callbacks raise that rclpy has made for a node.

    The message is dropped, and a request gets an empty response. An exception of the suite's own
    code, which such a callback may call, is raised as ever.

    Args:
        node: just made.
        refuse: called with the reason, with the name of the topic or service as the subject.
    """
    for subscription in node.subscriptions:
        if _is_foreign(subscription.callback):
            name = subscription.topic_name
            subscription.callback = _guarded(subscription.callback, name, refuse)
    for service in node.services:
        if _is_foreign(service.callback):
            service.callback = _guarded(service.callback, service.srv_name, refuse)


def _is_foreign(callback: Callable[..., Any]) -> bool:
    return callback.__module__.partition(".")[0] == "rclpy"


def _guarded(
    callback: Callable[..., Any], subject: str, refuse: Callable[[Refusal], object]
) -> Callable[..., Any]:
    @functools.wraps(callback)
    def guarded(message: Any, *response: Any) -> Any:
        try:
            return callback(message, *response)
        except Exception as error:
            if _passes_own_code(error.__traceback__):
                raise
            reason = f"rclpy cannot process the message: {type(error).__name__}: {error}"
            refuse(Refusal(subject, RefusalCode.MALFORMED, reason))
            return next(iter(response), None)

    return guarded


def _passes_own_code(traceback: TracebackType | None) -> bool:
    """Whether code of the suite was called below the frame that has caught the exception."""
    while traceback is not None and traceback.tb_next is not None:
        traceback = traceback.tb_next
        if traceback.tb_frame.f_globals["__name__"].partition(".")[0] == _OWN_PACKAGE:
            return True
    return False
