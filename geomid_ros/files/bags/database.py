"""SQLite files of rosbag2 (``.db3``).

They have no checksums. Their pages are checked for consistency, and only databases of the plain form that rosbag2
writes are read: views, generated columns and the like are programs of the file's writer, which would run here.
"""

from __future__ import annotations

import math
import re
import sqlite3
import struct
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

from geomid_ros.files.bags.storage import FaultError, Part, RawMessage, damaged
from geomid_ros.files.bags.unpacking import MOST_BYTES

_MAGIC = b"SQLite format 3\0"
_HEADER = 100  # bytes
_COLUMN = r"\s*\w+(?: (?:INTEGER|TEXT|BLOB|PRIMARY|KEY|AUTOINCREMENT|NOT|NULL))*\s*"
_PLAIN = re.compile(
    rf"CREATE TABLE \w+ ?\((?:{_COLUMN},)*{_COLUMN}\)|CREATE INDEX \w+ ON \w+ ?\( ?\w+(?: ASC| DESC)? ?\)"
)
_MOST_SCHEMA = 10_000  # characters of one statement
_MOST_MEMORY = 4 * MOST_BYTES  # that SQLite may take, in this process
_STEPS = 100_000  # of SQLite's machine, between two looks at how many there were
_MORE_STEPS = 10_000  # bytes of the file that are worth as many more
_RESCUE = "'sqlite3 FILE .recover' may save it"
# What rosbag2 has had from its first version on.
_NEEDED = {"topics": {"id", "name", "type", "serialization_format"}, "messages": {"topic_id", "timestamp", "data"}}


class Database:
    """An open SQLite file; see :class:`~geomid_ros.files.bags.storage.Storage`.

    Raises InputError naming the file, the place if SQLite knows it, and how much can be read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._size = path.stat().st_size
        self._topics: dict[int, tuple[str, str]] = {}
        self.counts: dict[tuple[str, str], int] = {}  # of messages, by topic and type
        self.start: int | None = None  # [ns] when the first message was recorded
        self._steps = 0
        header = self._header()
        # Immutable: SQLite neither locks the file nor looks for a journal beside it.
        self._database = sqlite3.connect(f"file:{quote(str(path))}?mode=ro&immutable=1", uri=True)
        self._database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_BYTES)
        self._database.set_progress_handler(self._too_long, _STEPS)
        try:
            list(self._query(f"PRAGMA hard_heap_limit = {_MOST_MEMORY}"))
            self._check_size(header)
            self._check_closed()
            self._check_schema()
            self._check_pages()
            self._read_topics()
        except FaultError as fault:
            part = self._part()
            self.close()
            raise damaged(path, fault, part) from fault

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Everything on ``topics`` in the order of recording."""
        wanted = [identity for identity, (topic, _) in self._topics.items() if topic in topics]
        places = ", ".join("?" * len(wanted))
        query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({places}) ORDER BY timestamp, rowid"  # noqa: S608
        count, last = 0, 0
        try:
            for identity, time, data in self._query(query, *wanted):
                if not isinstance(time, int) or not isinstance(data, bytes):
                    raise FaultError("a message's time is no integer, or its data are no bytes")  # noqa: TRY301
                count, last = count + 1, time
                yield RawMessage(self._topics[identity][0], time, self._topics[identity][1], data)
        except FaultError as fault:
            raise damaged(self._path, fault, Part(count, last, _RESCUE)) from fault

    def _query(self, text: str, *values: int) -> Iterator[Any]:
        """The rows of a query, which may take as many steps as the file's size is worth. Raises FaultError."""
        self._steps = 10 + self._size // _MORE_STEPS
        try:
            yield from self._database.execute(text, values)
        except (sqlite3.Error, UnicodeError) as error:  # its messages quote what may be no text
            raise FaultError(str(error)) from error
        except MemoryError as error:
            raise FaultError("it has a row that would need more memory than is allowed") from error

    def _too_long(self) -> bool:
        """Whether SQLite must stop: crafted pages can make it loop."""
        self._steps -= 1
        return self._steps < 0

    def _header(self) -> bytes:
        with self._path.open("rb") as file:
            header = file.read(_HEADER)
        if not self._size:
            raise damaged(self._path, FaultError("the file is empty", 0), Part(0, 0, ""))
        if header[: len(_MAGIC)] != _MAGIC or len(header) < _HEADER:
            raise damaged(self._path, FaultError("it does not begin as an SQLite database does", 0), Part(0, 0, ""))
        return header

    def _check_size(self, header: bytes) -> None:
        """Check the file's size against the header's page count, unless an old program changed the file."""
        page_size, changes, pages, changes_then = struct.unpack_from(">16xH6xII60xI", header)
        whole = pages * (page_size if page_size > 1 else 1 << 16)
        if changes == changes_then and whole > self._size:
            raise FaultError(f"of {whole} bytes, {self._size} are there", self._size)

    def _check_closed(self) -> None:
        """Refuse a file with a journal beside it: its recorder was killed, and part of it is in the journal."""
        for ending in ("-wal", "-journal"):
            journal = self._path.with_name(self._path.name + ending)
            if journal.is_file() and journal.stat().st_size:
                raise FaultError(
                    f"it was not closed: {journal.name} has a part of it, and 'sqlite3 FILE VACUUM' joins them"
                )

    def _check_schema(self) -> None:
        for name, text in self._query("SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL"):
            plain = re.sub(r"\s+", " ", text.replace('"', "")[:_MOST_SCHEMA]) if isinstance(text, str) else ""
            if not _PLAIN.fullmatch(plain):
                raise FaultError(f"{str(name)[:50]!r} is not of the plain tables and indices that rosbag2 writes")
        for table, needed in _NEEDED.items():
            found = {row[1] for row in self._query(f"PRAGMA table_info({table})")}
            if not needed <= found:
                raise FaultError(f"no rosbag2 database: it has no table '{table}' with {', '.join(sorted(needed))}")

    def _check_pages(self) -> None:
        ((answer,),) = self._query("PRAGMA integrity_check(1)")
        if answer != "ok":
            page = re.search(r"page (\d+)", answer, re.IGNORECASE)
            offset = (int(page[1]) - 1) * self._page_size if page else None
            raise FaultError(" ".join(str(answer).split())[:200], offset)

    @property
    def _page_size(self) -> int:
        ((size,),) = self._query("PRAGMA page_size")
        return int(size)

    def _read_topics(self) -> None:
        for identity, name, kind, encoding in self._query("SELECT id, name, type, serialization_format FROM topics"):
            if not all(isinstance(text, str) for text in (name, kind, encoding)):
                raise FaultError("a topic's name or type is no text")
            self._topics[identity] = name, kind if encoding == "cdr" else f"{kind} in {encoding}"
        self.counts = dict.fromkeys(self._topics.values(), 0)
        for identity, count, first in self._query("SELECT topic_id, count(*), min(timestamp) FROM messages GROUP BY 1"):
            if identity in self._topics:
                self.counts[self._topics[identity]] += count
            if isinstance(first, int):
                self.start = first if self.start is None else min(self.start, first)

    def _part(self) -> Part:
        """The part that can be read in the order of writing, while row numbers rise: damaged pages may lead back to
        others."""
        count, last, number = 0, 0, -math.inf
        try:
            # Else SQLite reads nothing at all of a file that is shorter than it should be.
            list(self._query("PRAGMA writable_schema = ON"))
            self._check_schema()
            for found, time in self._query("SELECT rowid, timestamp FROM messages NOT INDEXED"):
                if found <= number or not isinstance(time, int):
                    break
                count, last, number = count + 1, max(last, time), found
        except FaultError:
            pass
        return Part(count, last, _RESCUE)
