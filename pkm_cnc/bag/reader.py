"""Reads a run back: servo-rate topics as arrays, everything slower as message objects."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Footer, Schema
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
    try:
        channels, complete = _read(files[0])
    except OSError as error:
        raise InputError(f"bag {folder} cannot be read: {error.strerror}") from None
    servo, slow = {}, {}
    for channel in channels:
        if channel.typename in SERVO_FRAMES:
            dtype = codec(channel.typename, SERVO_FRAMES[channel.typename]).dtype
            servo[channel.topic] = _table(path, channel, dtype)
        elif channel.typename in typestore().fielddefs:
            slow[channel.topic] = [deserialize(data, channel.typename) for data in channel.messages()]
    return Run(path, servo, slow, complete)


@dataclass
class _ChannelContent:
    """The messages of one topic, end to end: a list of small objects would take several times their size."""

    topic: str
    typename: str
    content: bytearray = field(default_factory=bytearray)
    lengths: list[int] = field(default_factory=list)

    def add(self, message: bytes) -> None:
        self.content += message
        self.lengths.append(len(message))

    def messages(self) -> Iterator[bytes]:
        start = 0
        for length in self.lengths:
            yield bytes(self.content[start : start + length])
            start += length


def _read(path: Path) -> tuple[list[_ChannelContent], bool]:
    names: dict[int, str] = {}
    channels: dict[int, _ChannelContent] = {}
    complete = False
    with path.open("rb") as file:
        try:
            for record in StreamReader(file, emit_chunks=True).records:
                if isinstance(record, Schema):
                    names[record.id] = record.name
                elif isinstance(record, Channel):
                    channels.setdefault(
                        record.id, _ChannelContent(record.topic.lstrip("/"), names[record.schema_id])
                    )  # the summary repeats them
                elif isinstance(record, Chunk):
                    content = _chunk_content(record, path)
                    if zlib.crc32(content) != record.uncompressed_crc:
                        break
                    for number, message in _messages(content):
                        channels[number].add(message)
                elif isinstance(record, Footer):
                    complete = True
        except (McapError, struct.error, zstandard.ZstdError, ValueError, KeyError):  # what damage leads to
            if not names:
                raise InputError(f"bag {path}: not an MCAP file") from None
    return list(channels.values()), complete


def _chunk_content(chunk: Chunk, path: Path) -> bytes:
    if chunk.compression == "zstd":
        size = chunk.uncompressed_size
        return zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=size)
    if chunk.compression:
        raise InputError(f"bag {path}: compressed by {chunk.compression}; zstd or no compression can be read")
    return chunk.data


def _messages(content: bytes) -> Iterator[tuple[int, bytes]]:
    position = 0
    while position < len(content):
        opcode, length = _RECORD.unpack_from(content, position)
        end = position + _RECORD.size + length
        if opcode == Opcode.MESSAGE:
            yield _MESSAGE.unpack_from(content, position)[2], content[position + _MESSAGE.size : end]
        position = end


def _table(path: Path, channel: _ChannelContent, dtype: np.dtype[Any]) -> NDArray[Any]:
    if not set(channel.lengths) <= {dtype.itemsize}:
        raise InputError(
            f"bag {path}: /{channel.topic}: messages are not {dtype.itemsize} bytes long: made by another version?"
        )
    rows: NDArray[Any] = np.frombuffer(bytes(channel.content), dtype)
    gaps = np.flatnonzero(rows["cycle"] != np.arange(len(rows), dtype=np.uint64))
    if len(gaps):
        found = rows["cycle"][gaps[0]]
        raise InputError(f"bag {path}: /{channel.topic}: cycle {gaps[0]} is missing (found {found})")
    return rows
