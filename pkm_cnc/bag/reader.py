"""Reads a run back: servo-rate topics as arrays, everything slower as message objects.

A slower message is read by the definition that its bag holds, so that a bag outlives a change of the messages.
"""

from __future__ import annotations

import functools
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
from mcap.records import Channel as ChannelRecord
from mcap.records import Chunk, Footer, Schema
from mcap.stream_reader import StreamReader
from numpy.typing import NDArray
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from pkm_cnc.errors import InputError
from pkm_cnc.messages import codec, typestore
from pkm_cnc.topics import SERVO_FRAMES

__all__ = ["Channel", "Run", "read_channels", "read_run"]

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
    channels, complete = read_channels(folder)
    path = Path(folder)
    servo, slow = {}, {}
    for channel in channels.values():
        if channel.typename in SERVO_FRAMES:
            servo[channel.topic] = _table(path, channel)
        elif channel.typename in typestore().fielddefs:
            slow[channel.topic] = [channel.read(data) for data in channel.messages()]
    return Run(path, servo, slow, complete)


def read_channels(folder: Path | str) -> tuple[dict[str, Channel], bool]:
    """The messages of a bag folder, or of its .mcap file, by topic, and whether it was closed.

    Raises InputError where there is no such bag.
    """
    path = Path(folder)
    files = [path] if path.suffix == ".mcap" else sorted(path.glob("*.mcap")) if path.is_dir() else []
    if not files or not files[0].is_file():
        raise InputError(f"bag {folder}: no .mcap file there")
    try:
        channels, complete = _read(files[0])
    except OSError as error:
        raise InputError(f"bag {folder} cannot be read: {error.strerror}") from None
    return {channel.topic: channel for channel in channels}, complete


@dataclass
class Channel:
    """The messages of one topic, end to end: a list of small objects would take several times their size."""

    topic: str
    typename: str
    definition: str
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

    def read(self, data: bytes) -> Any:
        """The message object in the CDR bytes of one of them. Raises InputError where the bytes are no such message."""
        try:
            return _store(self.typename, self.definition).deserialize_cdr(data, self.typename)
        except (TypesysError, struct.error, ValueError, IndexError, UnicodeDecodeError) as error:
            raise InputError(f"/{self.topic}: a message cannot be read: {error}") from None


@functools.cache
def _store(typename: str, definition: str) -> Typestore:
    """The types that a definition with all that it needs describes; ours where they are the same."""
    if definition == typestore().generate_msgdef(typename, ros_version=2)[0]:
        return typestore()
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition, typename))
    return store


def _read(path: Path) -> tuple[list[Channel], bool]:
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    complete = False
    with path.open("rb") as file:
        try:
            for record in StreamReader(file, emit_chunks=True).records:
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, ChannelRecord):  # the summary repeats them
                    channels.setdefault(record.id, _channel(record, schemas[record.schema_id]))
                elif isinstance(record, Chunk):
                    content = _chunk_content(record, path)
                    if zlib.crc32(content) != record.uncompressed_crc:
                        break
                    for number, message in _messages(content):
                        channels[number].add(message)
                elif isinstance(record, Footer):
                    complete = True
        except (McapError, struct.error, zstandard.ZstdError, ValueError, KeyError):  # what damage leads to
            if not schemas:
                raise InputError(f"bag {path}: not an MCAP file") from None
    return list(channels.values()), complete


def _channel(record: ChannelRecord, schema: Schema) -> Channel:
    return Channel(record.topic.lstrip("/"), schema.name, schema.data.decode(errors="replace"))


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


def _table(path: Path, channel: Channel) -> NDArray[Any]:
    dtype = codec(channel.typename, SERVO_FRAMES[channel.typename]).dtype
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
