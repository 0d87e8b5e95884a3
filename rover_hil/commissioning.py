"""Whether what answers on the link is what the dictionary says: asked of each device by SDO.

A device of another revision, or one whose PDOs are mapped otherwise, would be misread without a
word. It blocks while it waits for answers, so it needs a thread of its own beside the one that
reads the link.
"""

from __future__ import annotations

import canopen
from canopen.objectdictionary import ODVariable

from rover_hil.dictionary import object_dictionary, variables
from rover_hil.objects import Device

_IDENTITY = (0x1000, 0x1018)
_MAPPINGS = ((0x1400, 0x1BFF),)  # communication and mapping of all PDOs
_CONSTANTS = (0x6076, 0x605A)
_ATTEMPTS = 3
_PATIENCE = 1.0  # with a machine that is busy [s]


def is_checked(variable: ODVariable) -> bool:
    """Whether a device must hold the dictionary's default there."""
    return variable.index in (*_IDENTITY, *_CONSTANTS) or any(
        low <= variable.index <= high for low, high in _MAPPINGS
    )


def mismatch(node: canopen.RemoteNode, device: Device) -> str:
    """What a device holds otherwise than its dictionary; empty: nothing.

    Raises:
        canopen.SdoCommunicationError: it does not answer.
    """
    own = object_dictionary(device)
    for variable in variables(own):
        if not is_checked(variable):
            continue
        where = f"{variable.index:04X}h:{variable.subindex:02X} {variable.name}"
        try:
            raw = _upload(node, variable.index, variable.subindex)
        except canopen.SdoAbortedError as error:
            return f"{where} cannot be read: {error}"
        held = own.get_variable(variable.index, variable.subindex)
        value = None if held is None else held.decode_raw(raw)
        if value != variable.default:
            return f"{where} is {value!r}, should be {variable.default!r}"
    return ""


def _upload(node: canopen.RemoteNode, index: int, subindex: int) -> bytes:
    node.sdo.RESPONSE_TIMEOUT = _PATIENCE
    for _ in range(_ATTEMPTS - 1):
        try:
            return bytes(node.sdo.upload(index, subindex))
        except canopen.SdoCommunicationError:  # a lost frame; an abort is an answer
            continue
    return bytes(node.sdo.upload(index, subindex))
