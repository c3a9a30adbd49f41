"""Messages as bytes without ROS: the one codec that the graph, the simulation and the bags share.

A servo-rate message has a fixed size, so it is packed by `struct` from a record (a tuple, see `pkm_cnc.records`) with
every padding byte zero: equal records give equal bytes. Everything slower goes through the type store of rosbags. The
layout comes from the installed `.msg` files of `pkm_cnc_msgs` alone. Encoding: CDR, little endian (OMG DDS-XTypes 7.4).
"""

from __future__ import annotations

import functools
import os
import struct
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from pkm_cnc.errors import InputError
from pkm_cnc.records import NANOSECONDS

__all__ = ["Codec", "codec", "deserialize", "message", "serialize", "stamp", "time_of", "typestore"]

_CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_FORMATS = {"bool": "?", "uint8": "B", "int32": "i", "uint32": "I", "uint64": "Q", "float64": "d"}
_BASE, _NAME = 1, 2
_STAMP = struct.Struct("<iI")
_MARKERS_STAMP, _HEADER_STAMP = 8, 4
"""Offset of the first stamp in a MarkerArray (behind the number of markers) and in a message with a header."""


def _message_folder() -> Path:
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    for prefix in [*filter(None, prefixes), sys.prefix]:
        folder = Path(prefix, "share", "pkm_cnc_msgs", "msg")
        if folder.is_dir():
            return folder
    raise InputError("pkm_cnc_msgs is not installed: no share/pkm_cnc_msgs/msg in AMENT_PREFIX_PATH or the environment")


@functools.cache
def typestore() -> Typestore:
    """The message types of ROS 2 Jazzy with those of pkm_cnc_msgs. Raises InputError where they are not installed."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types = {}
    for path in sorted(_message_folder().glob("*.msg")):
        types.update(get_types_from_msg(path.read_text(encoding="utf-8"), f"pkm_cnc_msgs/msg/{path.stem}"))
    store.register(types)
    return store


class Codec:
    """Packs and unpacks one message type whose fields, after `header` and `cycle`, are numbers or nested numbers.

    `dtype` reads many of its messages at once: `np.frombuffer(b"".join(messages), codec.dtype)`, with nested fields
    named by their path ("position.x").
    """

    def __init__(self, typename: str, frame_id: str) -> None:
        self.typename = typename
        self.frame_id = frame_id
        layout = "<4siI"  # CDR header, stamp
        names, formats, offsets = [], [], []
        frame = frame_id.encode() + b"\0"
        layout += f"I{len(frame)}s"
        self._frame = (len(frame), frame)
        for name, kind in _flat_fields(typename)[1:]:
            code = _FORMATS[kind]
            size = struct.calcsize("<" + code)
            padding = -(struct.calcsize(layout) - len(_CDR_LITTLE_ENDIAN)) % size
            layout += f"{padding}x"
            names.append(name)
            formats.append("<" + np.dtype(code).str[1:] if size > 1 else np.dtype(code).str)
            offsets.append(struct.calcsize(layout))
            layout += code
        self._end = -struct.calcsize(layout) % 4
        layout += f"{self._end}x"  # as DDS pads bytes; the end of a typed message it leaves
        self._struct = struct.Struct(layout)
        self.size = self._struct.size
        self.dtype = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": self.size})

    def pack(self, cycle: int, time: int, values: Sequence[float]) -> bytes:
        """The message's bytes: `time` = stamp in ns, `values` = its record."""
        seconds, nanoseconds = divmod(time, NANOSECONDS)
        return self._struct.pack(_CDR_LITTLE_ENDIAN, seconds, nanoseconds, *self._frame, cycle, *values)

    def unpack(self, data: bytes) -> tuple[int, tuple[Any, ...]]:
        """Cycle and values of a message. Raises ValueError where the length or the frame is another one."""
        if len(data) != self.size and len(data) + self._end == self.size:
            data += bytes(self._end)
        if len(data) != self.size:
            raise ValueError(f"{self.typename}: {len(data)} bytes received, {self.size} expected")
        fields = self._struct.unpack(data)
        if fields[4] != self._frame[1]:
            raise ValueError(f"{self.typename}: frame {fields[4]!r} received, {self.frame_id!r} expected")
        return fields[5], fields[6:]


def _flat_fields(typename: str) -> list[tuple[str, str]]:
    flat: list[tuple[str, str]] = []
    for name, (kind, detail) in typestore().fielddefs[typename][1]:
        if kind == _NAME:
            if detail == "std_msgs/msg/Header":
                flat.append((name, "header"))
            else:
                flat += [(f"{name}.{part}", base) for part, base in _flat_fields(str(detail))]
        elif kind == _BASE and detail[0] in _FORMATS:
            flat.append((name, str(detail[0])))
        else:
            raise ValueError(f"{typename}.{name}: not of fixed size")
    return flat


@functools.cache
def codec(typename: str, frame_id: str) -> Codec:
    """The codec of a servo-rate type, e.g. "pkm_cnc_msgs/msg/TcpSetpoint", with its constant frame."""
    return Codec(typename, frame_id)


def stamp(time: int) -> Any:
    """builtin_interfaces/Time of `time` ns."""
    return typestore().types["builtin_interfaces/msg/Time"](*divmod(time, NANOSECONDS))


def time_of(data: bytes, typename: str) -> int:
    """The stamp, ns, of a message that begins with a header, or of a MarkerArray that of its first marker."""
    offset = _MARKERS_STAMP if typename == "visualization_msgs/msg/MarkerArray" else _HEADER_STAMP
    seconds, nanoseconds = _STAMP.unpack_from(data, offset)
    return int(seconds * NANOSECONDS + nanoseconds)


def message(typename: str, **fields: Any) -> Any:
    """A message object of any type, for `serialize`; a field left out is zero, empty or false.

    `header=(time_ns, frame_id)` makes the header.
    """
    store = typestore()
    if isinstance(fields.get("header"), tuple):
        time, frame_id = fields["header"]
        fields["header"] = store.types["std_msgs/msg/Header"](stamp(time), frame_id)
    values = {}
    for name, (kind, detail) in store.fielddefs[typename][1]:
        values[name] = fields.pop(name) if name in fields else _neutral(kind, detail)
    if fields:
        raise ValueError(f"{typename} has no field {', '.join(fields)}")
    return store.types[typename](**values)


def _neutral(kind: int, detail: Any) -> Any:
    if kind == _NAME:
        return message(str(detail))
    if kind == _BASE:
        return {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}.get(detail[0], 0)
    if detail[0][0] == _BASE and detail[0][1][0] != "string":
        return np.zeros(detail[1] if kind == 3 else 0, dtype=detail[0][1][0])
    return []


def serialize(content: Any) -> bytes:
    """CDR bytes of a message object made by `message`, padded as DDS pads what it sends."""
    data = bytes(typestore().serialize_cdr(content, content.__msgtype__))
    return data + bytes(-len(data) % 4)


def deserialize(data: bytes, typename: str) -> Any:
    """The message object in CDR bytes."""
    return typestore().deserialize_cdr(data, typename)
