"""Scan an SQLite file written by ``ros2 bag record --storage sqlite3``.

The format has no checksums: all messages count as unverified. Damaged parts are skipped. The
recorder numbers rows consecutively, so missing numbers give the count of lost messages and their
neighbours the time. Nothing is written next to the bag: a file with a journal, or that ends within
a page, is read from a copy.
"""

import contextlib
import os
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

from msg_schemas.regular_files import open_regular
from rover_bags.files.file_scan import FileScan
from rover_bags.files.folder import ScanError
from rover_bags.files.records import Damage, DeclaredTopic, RecordedMessage
from rover_bags.files.store import BagError, standard_type

_MAGIC: Final = b"SQLite format 3\x00"
_JOURNALS: Final = ("-wal", "-journal")
_FARTHEST: Final = 1 << 40
"""Upper bound of row numbers, at which the search for a readable row ends."""


class SqliteScan(FileScan):
    """One pass over one SQLite file; without checksums and an index."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._surplus = 0

    def __iter__(self) -> Iterator[RecordedMessage]:
        self._check_header()
        with contextlib.ExitStack() as stack:
            source = self._readable(stack)
            uri = f"file:{quote(str(source))}?mode=ro"
            if source == self.path:
                uri += "&immutable=1"  # no lock and no journal: nothing is written
            try:
                database = sqlite3.connect(uri, uri=True)
            except sqlite3.Error as error:
                raise ScanError(f"cannot read {self.path}: {error}") from error
            stack.callback(database.close)
            yield from self._read(database)

    def _check_header(self) -> None:
        try:
            with open_regular(self.path) as stream:
                size = os.fstat(stream.fileno()).st_size
                head = stream.read(100)
        except OSError as error:
            raise ScanError(f"cannot read {self.path}: {error.strerror}") from error
        if not size:
            raise ScanError(f"{self.path} is empty: nothing was recorded in it")
        if len(head) < 100 or not head.startswith(_MAGIC):
            raise ScanError(f"{self.path} is not an SQLite file, or its beginning is damaged")
        page = int.from_bytes(head[16:18], "big")
        page = 65536 if page == 1 else page
        self._surplus = size % page if page else 0
        declared = page * int.from_bytes(head[28:32], "big")
        if declared > size:
            self.closed = False
            self._skip(
                f"the file is cut: {declared} bytes declared, {size} present",
                offset=size,
                length=declared - size,
            )

    def _readable(self, stack: contextlib.ExitStack) -> Path:
        """The file, or a copy with its journal and without an incomplete last page.

        SQLite would pad an incomplete page with zeros and read these as messages.
        """
        journals = [
            journal
            for suffix in _JOURNALS
            if (journal := Path(f"{self.path}{suffix}")).exists() and journal.stat().st_size
        ]
        if not journals and not self._surplus:
            return self.path
        self.closed = False
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="mother_rover_")))
        for file in (self.path, *journals):
            shutil.copy(file, folder / file.name)
        copy = folder / self.path.name
        if self._surplus:
            with copy.open("r+b") as stream:
                stream.truncate(copy.stat().st_size - self._surplus)
        return copy

    # --- rows ------------------------------------------------------------------------------------

    def _read(self, database: sqlite3.Connection) -> Iterator[RecordedMessage]:
        # Allows a file to be opened that is shorter than its header states.
        with contextlib.suppress(sqlite3.Error):
            database.execute("PRAGMA writable_schema=ON")
            database.execute("PRAGMA cell_size_check=ON")
        try:
            topics = dict(self._topics_of(database))
        except (sqlite3.Error, BagError) as error:
            self._skip(f"its topics cannot be read ({error}), so no message can be assigned")
            return
        self._topics = topics
        last_id = 0
        last_ns: int | None = None
        while True:
            try:
                for row in self._rows(database, last_id):
                    number, message = row[0], self._message(topics, row)
                    stamp = None if message is None else message.log_ns
                    if number > last_id + 1:
                        self._lose(number - last_id - 1, last_ns, stamp)
                    last_id = number
                    if message is not None:
                        last_ns = stamp
                        self.done += len(message.data)
                        yield message
            except sqlite3.Error as error:
                following = self._next_readable(database, last_id + 1)
                if following is None:
                    after = f"after {last_id} messages" if last_id else "from the first on"
                    self._skip(f"its messages cannot be read {after} ({error})", span=last_ns)
                    self.closed = False
                    return
                last_id, lost = following - 1, following - last_id - 1
                self._lose(lost, last_ns, None)
            else:
                return

    @staticmethod
    def _rows(database: sqlite3.Connection, after: int) -> Iterator[Any]:
        """Rows in their order; where the file is damaged SQLite may return others."""
        for row in database.execute(
            "SELECT id, topic_id, timestamp, data FROM messages WHERE id > ? ORDER BY id", (after,)
        ):
            if not isinstance(row[0], int) or row[0] <= after:
                raise sqlite3.DatabaseError(f"row {row[0]!r:.20} follows row {after}")
            after = row[0]
            yield row

    def _next_readable(self, database: sqlite3.Connection, start: int) -> int | None:
        """The next readable row, by exponential search and bisection."""

        def readable(number: int) -> int | None:
            try:
                row = next(iter(self._rows(database, number - 1)), None)
            except sqlite3.Error:
                return None
            return None if row is None else int(row[0])

        low, stride = start, 1
        while stride < _FARTHEST:
            found = readable(low + stride)
            if found is not None:
                break
            stride *= 2
        else:
            return None
        high = low + stride
        while high - low > 1:
            middle = (low + high) // 2
            if readable(middle) is None:
                low = middle
            else:
                high = middle
        return readable(high)

    def _message(self, topics: dict[int, DeclaredTopic], row: Any) -> RecordedMessage | None:
        number, topic_id, stamp, data = row
        topic = topics.get(topic_id) if isinstance(topic_id, int) else None
        is_time = isinstance(stamp, int) and stamp >= 0
        if topic is None or not is_time or not isinstance(data, bytes):
            self._skip(f"message {number} is damaged: its row is not a message")
            return None
        self.unverified[topic.name] += 1
        return RecordedMessage(topic, stamp, stamp, 0, data)

    @staticmethod
    def _topics_of(database: sqlite3.Connection) -> Iterator[tuple[int, DeclaredTopic]]:
        """Topics by number; columns differ between the releases of rosbag2."""
        columns = [row[1] for row in database.execute("PRAGMA table_info(topics)")]
        if not {"id", "name", "type"} <= set(columns):
            raise BagError("it has no topics table")
        definitions: dict[str, tuple[str, str]] = {}
        with contextlib.suppress(sqlite3.Error):
            definitions = {
                kind: (text, encoding)
                for kind, text, encoding in database.execute(
                    "SELECT topic_type, encoded_message_definition, encoding"
                    " FROM message_definitions"
                )
            }
        for row in database.execute(f"SELECT {', '.join(columns)} FROM topics"):
            values = dict(zip(columns, row, strict=True))
            if not isinstance(values["id"], int):
                raise BagError(f"a topic has the number {values['id']!r:.40}")
            kind = str(values["type"])
            if kind not in definitions:
                with contextlib.suppress(BagError):
                    known = standard_type(kind)
                    definitions[kind] = (known.schema.decode(), known.encoding)
            schema, encoding = definitions.get(kind, ("", ""))
            yield (
                values["id"],
                DeclaredTopic(
                    name=str(values["name"]),
                    type=kind,
                    encoding=str(values.get("serialization_format", "cdr")),
                    schema=schema,
                    schema_encoding=encoding,
                    qos=str(values.get("offered_qos_profiles") or ""),
                    type_hash=str(values.get("type_description_hash") or ""),
                ),
            )

    # --- losses ----------------------------------------------------------------------------------

    def _lose(self, count: int, before_ns: int | None, after_ns: int | None) -> None:
        known = [stamp for stamp in (before_ns, after_ns) if stamp is not None]
        words = "message" if count == 1 else "messages"
        self.damage.append(
            Damage(
                self.path.name, 0, 0, f"{count} {words} of unknown topics cannot be read", {},
                (known[0], known[-1]) if known else None,
            )
        )  # fmt: skip

    def _skip(
        self, reason: str, *, offset: int = 0, length: int = 0, span: int | None = None
    ) -> None:
        spanned = None if span is None else (span, span)
        self.damage.append(Damage(self.path.name, offset, length, reason, {}, spanned))
