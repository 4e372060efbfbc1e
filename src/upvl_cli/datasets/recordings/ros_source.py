"""Messages of ROS recordings: MCAP files, rosbag2 folders, and `.bag` files, one way to read them.

MCAP files are read by `mcap`, which reads those without an index and those that were cut off too; the others by
`rosbags`, which also knows the types of messages. Neither needs ROS.
"""

from __future__ import annotations

import contextlib
import re
import struct
import zlib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from upvl_cli.datasets.shared.content import read_text
from upvl_cli.errors import BadInput, BadSetting, one_line

_COMPRESSED = re.compile(r"compression_mode:\s*['\"]?message", re.IGNORECASE)
_MCAP_START = b"\x89MCAP0\r\n"
# What the libraries raise at damaged bytes, beside errors of their own.
_DAMAGE = (
    ValueError, TypeError, LookupError, ArithmeticError, AttributeError, AssertionError, EOFError, RuntimeError,
    MemoryError, OSError, struct.error, zlib.error,
)  # fmt: skip


@dataclass(frozen=True)
class RosTopic:
    """One topic: the type of its messages, for example `sensor_msgs/msg/PointCloud2`, and how many there are."""

    name: str
    type: str
    count: int


@dataclass(frozen=True, eq=False)
class RosMessage:
    """One message: when it was logged, and what it says."""

    topic: str
    log_ns: int
    type: str
    encoding: str
    data: bytes


class RosSource(Protocol):
    """Where messages come from."""

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that is read."""

    @property
    def topics(self) -> Mapping[str, RosTopic]:
        """All topics by name."""

    def messages(self, topics: Collection[str], start_ns: int | None = None) -> Iterator[RosMessage]:
        """Yield the messages of topics in the order of their log times."""


def is_ros(source: Path) -> bool:
    """Whether a path is a ROS recording."""
    if source.is_dir():
        return (source / "metadata.yaml").is_file() or any(_mcap_files(source)) or any(source.glob("*.db3"))
    return source.suffix.lower() in (".mcap", ".db3", ".bag")


def open_source(source: Path) -> RosSource:
    """Return the messages of a recording.

    Args:
        source: An `.mcap`, `.db3` or `.bag` file, or the folder of a rosbag2 recording.

    Raises:
        BadSetting: The packages for it are not installed.
        BadInput: It is damaged.
    """
    try:
        import mcap.reader
        import rosbags.typesys
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        raise BadSetting(
            f"reading {source.name} needs the package {package}; run: pip install 'upvl[ros]' (ROS is not needed)"
        ) from None
    del mcap, rosbags
    mcap_files = (
        _mcap_files(source) if source.is_dir() else [source] if source.suffix.lower() == ".mcap" else []
    )
    index = source / "metadata.yaml"
    if index.is_file() and _COMPRESSED.search(read_text(index)):
        mcap_files = []  # each message is packed on its own, of which only the folder's index tells
    with damage(source):
        return McapSource(tuple(mcap_files)) if mcap_files else BagSource(source)


def _mcap_files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix.lower() == ".mcap" and path.is_file())


def library_errors() -> tuple[type[Exception], ...]:
    """Return what the libraries, and the databases and compressors below them, raise at damaged files."""
    import apsw
    from mcap.exceptions import McapError
    from rosbags.rosbag1 import ReaderError as BagError
    from rosbags.rosbag2 import ReaderError
    from rosbags.serde import SerdeError
    from ruamel.yaml.error import YAMLError
    from zstandard import ZstdError

    return (McapError, BagError, ReaderError, SerdeError, YAMLError, ZstdError, apsw.Error, *_DAMAGE)


@contextlib.contextmanager
def damage(where: object) -> Iterator[None]:
    """Raise what the libraries find wrong with a recording as `BadInput`."""
    try:
        yield
    except BadInput:
        raise
    except library_errors() as error:
        reason = one_line(error)[:120] or type(error).__name__
        raise BadInput(
            f"{where} cannot be read as a ROS recording ({reason}); copy it again, or mend it with: mcap recover"
        ) from None


class McapSource:
    """MCAP files, one after the other."""

    def __init__(self, files: tuple[Path, ...]) -> None:
        self.files = files
        self.topics: dict[str, RosTopic] = {}
        for path in files:
            self._add_topics(path)

    def _add_topics(self, path: Path) -> None:
        from mcap.reader import make_reader

        with path.open("rb") as file:
            if file.read(8) != _MCAP_START:
                raise BadInput(f"{path} is no MCAP file; copy it again")
            file.seek(0)
            summary = None
            with contextlib.suppress(
                Exception
            ):  # cut off, or without a summary: then it is read once as a stream
                summary = make_reader(file).get_summary()
            if summary is not None and summary.statistics is not None and summary.channels:
                counts = summary.statistics.channel_message_counts
                for channel in summary.channels.values():
                    schema = summary.schemas.get(channel.schema_id)
                    self._count(channel.topic, schema.name if schema else "", counts.get(channel.id, 0))
                return
        for message in self._stream(path, None):
            self._count(message.topic, message.type, 1)

    def _count(self, topic: str, kind: str, count: int) -> None:
        known = self.topics.get(topic, RosTopic(topic, ros_type(kind), 0))
        self.topics[topic] = RosTopic(topic, known.type, known.count + count)

    def messages(self, topics: Collection[str], start_ns: int | None = None) -> Iterator[RosMessage]:
        """Yield the messages of topics; of a file that was cut off, those before the cut."""
        from mcap.reader import make_reader

        for path in self.files:
            with damage(path), path.open("rb") as file:
                reader: Any = make_reader(file)
                is_indexed = False
                with contextlib.suppress(*library_errors()):
                    summary = reader.get_summary()
                    is_indexed = summary is not None and bool(summary.chunk_indexes)
                if not is_indexed:
                    yield from self._stream(path, set(topics), start_ns)
                    continue
                for schema, channel, message in reader.iter_messages(
                    topics=list(topics), starting_at=start_ns
                ):
                    yield _mcap_message(schema, channel, message)

    def _stream(
        self, path: Path, topics: set[str] | None, start_ns: int | None = None
    ) -> Iterator[RosMessage]:
        """Yield messages in the order of the file, up to where it ends or breaks."""
        from mcap.records import Channel, Message, Schema
        from mcap.stream_reader import StreamReader

        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        errors: tuple[type[Exception], ...] = (StopIteration, *library_errors())
        with path.open("rb") as file:
            records = StreamReader(file).records
            while True:
                try:
                    record = next(records)
                except errors:
                    return
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    channels[record.id] = record
                elif isinstance(record, Message) and record.channel_id in channels:
                    channel = channels[record.channel_id]
                    is_late = start_ns is None or record.log_time >= start_ns
                    if is_late and (topics is None or channel.topic in topics):
                        yield _mcap_message(schemas.get(channel.schema_id), channel, record)


def _mcap_message(schema: Any, channel: Any, message: Any) -> RosMessage:
    kind = ros_type(schema.name if schema else "")
    return RosMessage(channel.topic, message.log_time, kind, channel.message_encoding, message.data)


def ros_type(name: str) -> str:
    """Return the name of a type as ROS 2 has it: ROS 1 leaves `msg` out."""
    package, _, kind = name.partition("/")
    return f"{package}/msg/{kind}" if kind and "/" not in kind else name


class BagSource:
    """A rosbag2 folder or database, or a `.bag` of ROS 1."""

    def __init__(self, source: Path) -> None:
        self._source = source
        self.files = (
            tuple(sorted(path for path in source.iterdir() if path.is_file()))
            if source.is_dir()
            else (source,)
        )
        with self._opened() as reader:
            self.topics = {
                name: RosTopic(name, ros_type(info.msgtype or ""), info.msgcount)
                for name, info in reader.topics.items()
            }

    def _opened(self) -> Any:
        from rosbags.rosbag1 import Reader as BagReader
        from rosbags.rosbag2 import Reader

        return BagReader(self._source) if self._source.suffix.lower() == ".bag" else Reader(self._source)

    def messages(self, topics: Collection[str], start_ns: int | None = None) -> Iterator[RosMessage]:
        """Yield the messages of topics in the order of their log times."""
        is_ros1 = self._source.suffix.lower() == ".bag"
        with damage(self._source), self._opened() as reader:
            connections = [known for known in reader.connections if known.topic in topics]
            if not connections:
                return
            for connection, log_ns, data in reader.messages(connections, start=start_ns):
                encoding = "ros1" if is_ros1 else "cdr"
                yield RosMessage(
                    connection.topic, log_ns, ros_type(connection.msgtype), encoding, bytes(data)
                )


class Decoder:
    """Decode messages of ROS's own types, which are the same in all distributions of ROS 2."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_typestore

        self._ros2 = get_typestore(Stores.ROS2_HUMBLE)
        self._ros1 = get_typestore(Stores.ROS1_NOETIC)

    def decode(self, message: RosMessage) -> Any:
        """Return the message; raises `BadInput` where it is damaged or of no type of ROS."""
        with damage(f"a message of {message.topic}"):
            if message.encoding == "cdr":
                return self._ros2.deserialize_cdr(message.data, message.type)
            if message.encoding in ("ros1", "ros1msg"):
                return self._ros1.deserialize_ros1(message.data, message.type)
        raise BadInput(
            f"messages of {message.topic} are encoded as {message.encoding!r}; expected cdr or ros1"
        )
