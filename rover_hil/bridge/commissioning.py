"""Compare each device on the link with its object dictionary by SDO.

A device of another revision or with other PDO mappings would be misread silently. The comparison
blocks while it waits for responses: call it in another thread than the one that reads the link.
"""

from __future__ import annotations

import struct

import canopen
from canopen.objectdictionary import ODVariable

from rover_hil.canopen.dictionary import object_dictionary, variables
from rover_hil.canopen.objects import Device

_IDENTITY = (0x1000, 0x1018)
# SYNC and its counter, emergencies, and the bridge's heartbeat, which the device watches.
_COMMUNICATION = (0x1005, 0x1014, 0x1016, 0x1019)
_PDOS, _MAPPINGS = range(0x1400, 0x1C00), (*range(0x1600, 0x1800), *range(0x1A00, 0x1C00))
_CONSTANTS = (0x6076, 0x605A, 0x6085)
_ATTEMPTS = 3
_TIMEOUT = 1.0  # of a response [s]


def is_checked(variable: ODVariable) -> bool:
    """Whether the device's value must equal the default of the dictionary.

    Records may have more members than the dictionary names, such as a serial number or an inhibit
    time; a mapping may not.
    """
    index = variable.index
    if variable.subindex == 0 and index in (0x1016, 0x1018, *_PDOS) and index not in _MAPPINGS:
        return False
    return index in (*_IDENTITY, *_COMMUNICATION, *_CONSTANTS, *_PDOS)


def mismatch(node: canopen.RemoteNode, device: Device) -> str:
    """First difference of a device from its dictionary; empty: none.

    Raises:
        canopen.SdoCommunicationError: it does not respond.
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
        expected = own.get_variable(variable.index, variable.subindex)
        try:
            value = None if expected is None else expected.decode_raw(raw)
        except (ValueError, struct.error, canopen.ObjectDictionaryError):
            return f"{where} has {len(raw)} bytes, which are no value of its type"
        if value != variable.default:
            return f"{where} is {value!r}, should be {variable.default!r}"
    return ""


def _upload(node: canopen.RemoteNode, index: int, subindex: int) -> bytes:
    node.sdo.RESPONSE_TIMEOUT = _TIMEOUT
    for _ in range(_ATTEMPTS - 1):
        try:
            return _upload_once(node, index, subindex)
        except canopen.SdoCommunicationError:  # a lost frame; an abort is a response
            continue
    return _upload_once(node, index, subindex)


def _upload_once(node: canopen.RemoteNode, index: int, subindex: int) -> bytes:
    try:
        return bytes(node.sdo.upload(index, subindex))
    except (struct.error, IndexError, ValueError, TypeError) as error:
        # The library assumes responses of the right length.
        raise canopen.SdoCommunicationError(f"malformed response: {error}") from error
