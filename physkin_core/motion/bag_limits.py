"""Limits to what a bag makes of its bytes: `rosbags` unpacks, follows and repeats whatever a file tells it to."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import apsw
import lz4.frame
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS, zstd

from physkin_core.file_reading import ContentError, read_bytes
from physkin_core.yaml_limits import check_yaml

__all__ = ["check_before_opening", "check_opened", "unpacked_message", "without_views"]

LARGEST_METADATA = 1 << 20  # [bytes]
LARGEST_MESSAGE = 1 << 24  # [bytes]; those that are read take kilobytes
LARGEST_CHUNK = 1 << 28  # [bytes]; recorders write up to some megabytes, and a message more
ALWAYS_UNPACKED = 1 << 30  # [bytes] of a file
ALWAYS_UNPACKED_CHUNK = 1 << 24  # [bytes]
MOST_UNPACKED = 100  # times a size
MOST_TOPICS = 5000


def check_before_opening(path: Path) -> None:
    """Raises ContentError where opening a bag, a file or folder, would not end, or fill the disk."""
    from ruamel.yaml import YAML

    if path.is_dir() and (metadata := path / "metadata.yaml").is_file():
        check_yaml(YAML(typ="safe").parse(read_bytes(metadata, most=LARGEST_METADATA)))
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        if file.is_dir() or not file.exists():
            continue
        if not file.is_file():
            raise ContentError(f"{file.name} is not a regular file; a pipe or device cannot be read")
        if file.suffix == ".zstd":
            _check_unpacked(file)


@contextmanager
def without_views() -> Iterator[None]:
    """Databases that are opened meanwhile have tables only: a view in the place of one may have rows without end."""

    def forbid(connection: apsw.Connection) -> None:
        connection.config(apsw.SQLITE_DBCONFIG_ENABLE_VIEW, 0)

    apsw.connection_hooks.append(forbid)
    try:
        yield
    finally:
        apsw.connection_hooks.remove(forbid)


def check_opened(bag: Reader) -> None:
    """Raises ContentError where reading the messages of an open bag could take memory or time without end."""
    if len(bag.connections) > MOST_TOPICS:
        raise ContentError(f"it has {len(bag.connections)} topics, allowed are {MOST_TOPICS}")
    for storage in getattr(bag.storage, "storages", [bag.storage]):
        unpacked = sum(chunk.uncompressed_size for chunk in getattr(storage, "chunks", []))
        if unpacked > (most := _most_unpacked(storage.path)):
            raise ContentError(f"the chunks of {storage.path.name} unpack to {unpacked} bytes, allowed are {most}")


def unpacked_message(data: bytes, *, compressed: bool) -> bytes:
    """The bytes of a message. Raises ContentError for more than a message may have."""
    if compressed:
        with zstd.open(BytesIO(data)) as stream:
            data = stream.read(LARGEST_MESSAGE + 1)
    if len(data) > LARGEST_MESSAGE:
        raise ContentError(f"one of its messages has more than the {LARGEST_MESSAGE} bytes that are allowed")
    return data


def _most_unpacked(file: Path) -> int:
    return max(ALWAYS_UNPACKED, MOST_UNPACKED * file.stat().st_size)


def _check_unpacked(file: Path) -> None:
    unpacked, most = 0, _most_unpacked(file)
    with zstd.open(file) as stream:
        while part := stream.read(1 << 20):
            unpacked += len(part)
            if unpacked > most:
                raise ContentError(f"{file.name} unpacks to more than the {most} bytes that are allowed")


def _limited(opened: Callable) -> Callable[[bytes, int], bytes]:
    """A function that unpacks a chunk to the size that it claims, and a byte more where there is more, which the
    library refuses; its own unpacks to whatever comes."""

    def unpack(data: bytes, size: int) -> bytes:
        most = min(LARGEST_CHUNK, max(ALWAYS_UNPACKED_CHUNK, MOST_UNPACKED * len(data)))
        if size > most:
            raise ReaderError(f"a chunk of {len(data)} bytes claims to unpack to {size}, allowed are {most}")
        with opened(BytesIO(data)) as stream:
            return stream.read(size + 1)

    return unpack


DECOMPRESSORS.update(zstd=_limited(zstd.open), lz4=_limited(lz4.frame.open))
