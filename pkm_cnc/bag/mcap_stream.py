"""Writes an MCAP file as a stream of small, flushed chunks (https://mcap.dev/spec).

The records are those of the `mcap` package; only the path that every message takes is written out here, because a
machine second holds 12,000 messages. A killed process loses at most the chunk it was filling.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

__all__ = ["McapStream"]

_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_MESSAGE_FIELDS = _MESSAGE.size - 9
_INDEX = struct.Struct("<BQHI")  # opcode, length, channel, bytes of the array


class McapStream:
    """An MCAP file being written: `add_channel` first, then `write` and at the end `close`.

    `chunk_bytes`: a chunk is compressed and written as soon as it holds that much. Raises OSError; after that nothing
    more is written, so that no record stands behind half of another.
    """

    def __init__(self, path: Path, chunk_bytes: int) -> None:
        self._file = path.open("xb", buffering=0)
        self._failure: OSError | None = None
        self._chunk_bytes = chunk_bytes
        self._compressor = zstandard.ZstdCompressor(level=1)
        self._schemas: dict[str, Schema] = {}
        self._channels: list[Channel] = []
        self._counts: list[int] = []
        self._chunks: list[ChunkIndex] = []
        self._first_time = 0
        self._last_time = 0
        self._messages: list[tuple[int, int, bytes]] = []
        self._held = 0
        self._write(MCAP0_MAGIC)
        self._put([Header(profile="ros2", library="pkm_cnc")])

    def add_channel(self, topic: str, typename: str, definition: str, metadata: dict[str, str]) -> int:
        """Declare a topic of a ROS message type; return the channel number that `write` takes."""
        if typename not in self._schemas:
            schema = Schema(id=len(self._schemas) + 1, name=typename, encoding="ros2msg", data=definition.encode())
            self._schemas[typename] = schema
            self._put([schema])
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding="cdr",
            schema_id=self._schemas[typename].id,
            metadata=metadata,
        )
        self._channels.append(channel)
        self._counts.append(0)
        self._put([channel])
        return channel.id

    def write(self, channel: int, time: int, data: bytes) -> None:
        """Append one message; `time` = log and publish time, ns."""
        self._messages.append((channel, time, data))
        self._held += len(data) + _MESSAGE.size
        if self._held >= self._chunk_bytes:
            self.flush()

    def flush(self) -> None:
        """Write what is held as one chunk and hand it to the operating system."""
        if not self._messages:
            return
        parts: list[bytes] = []
        index: dict[int, list[int]] = {}
        offset, first, last = 0, self._messages[0][1], 0
        for channel, time, data in self._messages:
            self._counts[channel - 1] += 1
            parts.append(
                _MESSAGE.pack(
                    Opcode.MESSAGE, _MESSAGE_FIELDS + len(data), channel, self._counts[channel - 1], time, time
                )
            )
            parts.append(data)
            index.setdefault(channel, []).extend((time, offset))
            offset += _MESSAGE.size + len(data)
            first, last = min(first, time), max(last, time)
        self._put_chunk(b"".join(parts), index, first, last)
        self._messages.clear()
        self._held = 0

    def _put_chunk(self, content: bytes, index: dict[int, list[int]], first: int, last: int) -> None:
        start = self._file.tell()
        compressed = self._compressor.compress(content)
        self._put(
            [
                Chunk(
                    compression="zstd",
                    data=compressed,
                    message_start_time=first,
                    message_end_time=last,
                    uncompressed_crc=zlib.crc32(content),
                    uncompressed_size=len(content),
                )
            ]
        )
        index_start = self._file.tell()
        offsets = {}
        for channel, entries in sorted(index.items()):
            offsets[channel] = self._file.tell()
            array = np.array(entries, dtype="<u8").tobytes()
            self._write(_INDEX.pack(Opcode.MESSAGE_INDEX, 6 + len(array), channel, len(array)) + array)
        if not self._chunks:
            self._first_time = first
        self._first_time, self._last_time = min(self._first_time, first), max(self._last_time, last)
        self._chunks.append(
            ChunkIndex(
                chunk_length=index_start - start,
                chunk_start_offset=start,
                compression="zstd",
                compressed_size=len(compressed),
                message_end_time=last,
                message_index_length=self._file.tell() - index_start,
                message_index_offsets=offsets,
                message_start_time=first,
                uncompressed_size=len(content),
            )
        )

    @property
    def counts(self) -> list[int]:
        """Messages written per channel, in the order the channels were added."""
        return list(self._counts)

    @property
    def span(self) -> tuple[int, int]:
        """Earliest and latest time written, ns."""
        return self._first_time, self._last_time

    def close(self) -> None:
        """Write what is held and the summary, then close the file."""
        try:
            self.flush()
            self._put([DataEnd(data_section_crc=0)])
            self._put_summary()
            self._write(MCAP0_MAGIC)
        finally:
            self._file.close()

    def _put_summary(self) -> None:
        start = self._file.tell()
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts={number + 1: count for number, count in enumerate(self._counts)},
            chunk_count=len(self._chunks),
            message_count=sum(self._counts),
            metadata_count=0,
            message_start_time=self._first_time,
            message_end_time=self._last_time,
            schema_count=len(self._schemas),
        )
        groups: list[tuple[Opcode, Iterable[McapRecord]]] = [
            (Opcode.SCHEMA, self._schemas.values()),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [statistics]),
            (Opcode.CHUNK_INDEX, self._chunks),
        ]
        summary, offsets = b"", []
        for opcode, group in groups:
            content = _bytes(group)
            offsets.append(
                SummaryOffset(group_opcode=opcode, group_start=start + len(summary), group_length=len(content))
            )
            summary += content
        offset_start = start + len(summary)
        summary += _bytes(offsets)
        unsummed = _bytes([Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=0)])
        crc = zlib.crc32(summary + unsummed[:-4])
        self._write(summary)
        self._put([Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=crc)])

    def _put(self, content: Iterable[McapRecord]) -> None:
        self._write(_bytes(content))

    def _write(self, data: bytes) -> None:
        if self._failure is not None:
            raise self._failure
        left = memoryview(data)
        try:
            while left:
                left = left[self._file.write(left) :]
        except OSError as error:
            self._failure = error
            raise


def _bytes(content: Iterable[McapRecord]) -> bytes:
    builder = RecordBuilder()
    for record in content:
        record.write(builder)
    return bytes(builder.end())  # type: ignore[no-untyped-call]
