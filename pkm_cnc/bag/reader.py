"""Reads a run back: servo-rate topics as arrays, everything slower as message objects."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Schema
from mcap.stream_reader import StreamReader
from numpy.typing import NDArray

from pkm_cnc.errors import InputError
from pkm_cnc.messages import codec, deserialize, typestore
from pkm_cnc.topics import SERVO_FRAMES

__all__ = ["Run", "read_run"]

_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<BQHIQQ")


@dataclass(frozen=True)
class Run:
    """A recorded run.

    `servo[topic]` is a structured array of one row a cycle, in cycle order, with the message's fields ("cycle",
    "position.x", ...), SI; `slow[topic]` the messages of a slower topic. `complete` is False for a bag that was never
    closed: it then ends with the last whole chunk.
    """

    folder: Path
    servo: dict[str, NDArray[Any]]
    slow: dict[str, list[Any]]
    complete: bool

    def cycles(self) -> int:
        """Number of cycles that every servo-rate topic holds, counted from cycle 0."""
        return min((int(rows["cycle"][-1]) + 1 if len(rows) else 0 for rows in self.servo.values()), default=0)


def read_run(folder: Path | str) -> Run:
    """Read a bag folder, or its .mcap file.

    Raises InputError where there is no such bag, it is not one of ours, or a servo-rate topic misses a cycle.
    """
    path = Path(folder)
    files = [path] if path.suffix == ".mcap" else sorted(path.glob("*.mcap")) if path.is_dir() else []
    if not files or not files[0].is_file():
        raise InputError(f"bag {folder}: no .mcap file there")
    types: dict[int, tuple[str, str]] = {}
    data: dict[int, list[bytes]] = {}
    complete = _read(files[0], types, data)
    servo, slow = {}, {}
    for number, (topic, typename) in types.items():
        messages = data.get(number, [])
        if typename in SERVO_FRAMES:
            servo[topic] = _table(path, topic, messages, codec(typename, SERVO_FRAMES[typename]).dtype)
        elif typename in typestore().fielddefs:
            slow[topic] = [deserialize(content, typename) for content in messages]
    return Run(path, servo, slow, complete)


def _read(path: Path, types: dict[int, tuple[str, str]], data: dict[int, list[bytes]]) -> bool:
    names: dict[int, str] = {}
    decompressor = zstandard.ZstdDecompressor()
    with path.open("rb") as file:
        try:
            for record in StreamReader(file, emit_chunks=True).records:
                if isinstance(record, Schema):
                    names[record.id] = record.name
                elif isinstance(record, Channel):
                    types[record.id] = (record.topic.lstrip("/"), names[record.schema_id])
                elif isinstance(record, Chunk):
                    content = decompressor.decompress(record.data, max_output_size=record.uncompressed_size)
                    if zlib.crc32(content) != record.uncompressed_crc:
                        return False
                    for channel, message in _messages(content):
                        data.setdefault(channel, []).append(message)
                elif isinstance(record, DataEnd):
                    return True
        except (McapError, struct.error, zstandard.ZstdError, ValueError, KeyError):  # what damage leads to
            if not names:
                raise InputError(f"bag {path}: not an MCAP file") from None
    return False


def _messages(content: bytes) -> Iterator[tuple[int, bytes]]:
    position = 0
    while position < len(content):
        opcode, length = _RECORD.unpack_from(content, position)
        end = position + _RECORD.size + length
        if opcode == Opcode.MESSAGE:
            yield _MESSAGE.unpack_from(content, position)[2], content[position + _MESSAGE.size : end]
        position = end


def _table(path: Path, topic: str, messages: list[bytes], dtype: np.dtype[Any]) -> NDArray[Any]:
    joined = b"".join(messages)
    if len(joined) != len(messages) * dtype.itemsize:
        raise InputError(
            f"bag {path}: /{topic}: messages are not {dtype.itemsize} bytes long: made by another version?"
        )
    rows = np.frombuffer(joined, dtype)
    gaps = np.flatnonzero(rows["cycle"] != np.arange(len(rows), dtype=np.uint64))
    if len(gaps):
        raise InputError(f"bag {path}: /{topic}: cycle {gaps[0]} is missing (found {rows['cycle'][gaps[0]]})")
    return rows
