"""A rosbag2 folder that is filled while the machine runs."""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType

import yaml

from pkm_cnc.bag.mcap_stream import McapStream
from pkm_cnc.errors import InputError, MachineFault
from pkm_cnc.messages import typestore
from pkm_cnc.topics import Topic

__all__ = ["BagWriter", "refuse_existing"]

CHUNK_BYTES = 256 * 1024
"""A chunk holds about 0.2 s of a Tripod at 1 kHz: what SIGKILL can lose."""


def refuse_existing(folder: Path | str) -> None:
    """Raise InputError where a bag's folder exists, or cannot because of its name."""
    try:
        exists = Path(folder).exists()
    except OSError as error:
        raise InputError(f"bag {folder} cannot be created: {error.strerror}") from None
    if exists:
        raise InputError(f"bag {folder} exists already: choose another name or remove it")


class BagWriter:
    """Context manager: a new rosbag2 folder (MCAP, zstd chunks) with the topics it will hold.

    Leaving it closes the file and writes `metadata.yaml`. Raises InputError where the folder exists or cannot be made,
    MachineFault where the disk fails while writing; the chunks written by then stay readable.
    """

    def __init__(self, folder: Path | str, topics: Iterable[Topic]) -> None:
        self.folder = Path(folder)
        self._topics = list(topics)
        refuse_existing(folder)
        self._file_name = f"{self.folder.name}_0.mcap"
        try:
            self.folder.mkdir(parents=True)
        except OSError as error:
            raise InputError(f"bag {self.folder} cannot be created: {error.strerror}") from None
        try:
            self._stream = McapStream(self.folder / self._file_name, CHUNK_BYTES)
            self._channels = {topic.name: self._add(topic) for topic in self._topics}
        except OSError as error:
            shutil.rmtree(self.folder, ignore_errors=True)  # nothing is recorded yet: the name stays free
            raise InputError(f"bag {self.folder} cannot be created: {error.strerror}") from None

    def _add(self, topic: Topic) -> int:
        definition, _ = typestore().generate_msgdef(topic.typename, ros_version=2)
        return self._stream.add_channel(
            f"/{topic.name}", topic.typename, definition, {"offered_qos_profiles": "", "topic_type_hash": _hash(topic)}
        )

    def write(self, topic: str, time: int, data: bytes) -> None:
        """Append the CDR bytes of one message; `time` = its stamp, ns. Raises MachineFault where the disk fails."""
        try:
            self._stream.write(self._channels[topic], time, data)
        except OSError as error:
            raise MachineFault(f"bag {self.folder}: {error.strerror}; what was written before stays readable") from None

    def close(self) -> None:
        """Finish the file. Raises MachineFault where the disk fails."""
        try:
            self._stream.close()
            text = yaml.safe_dump({"rosbag2_bagfile_information": self._metadata()}, sort_keys=False)
            (self.folder / "metadata.yaml").write_text(text, encoding="utf-8")
        except OSError as error:
            raise MachineFault(f"bag {self.folder}: {error.strerror}; what was written before stays readable") from None

    def _metadata(self) -> dict[str, object]:
        counts = self._stream.counts
        first, last = self._stream.span
        span = {
            "duration": {"nanoseconds": last - first},
            "starting_time": {"nanoseconds_since_epoch": first},
            "message_count": sum(counts),
        }
        return {
            "version": 9,
            "storage_identifier": "mcap",
            **span,
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": f"/{topic.name}",
                        "type": topic.typename,
                        "serialization_format": "cdr",
                        "offered_qos_profiles": [],
                        "type_description_hash": _hash(topic),
                    },
                    "message_count": count,
                }
                for topic, count in zip(self._topics, counts, strict=True)
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self._file_name],
            "files": [{"path": self._file_name, **span}],
            "custom_data": None,
            "ros_distro": "jazzy",
        }

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _hash(topic: Topic) -> str:
    return typestore().hash_rihs01(topic.typename)
