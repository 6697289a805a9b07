"""SQLite files of rosbag2 (``.db3``).

They have no checksums. Their pages are checked for consistency. Only databases of the plain form that rosbag2 writes
are read: views, generated columns and the like are programs of the file's author, which would run here.

Of a truncated file, the rows before the first missing page are read. A write-ahead log that a killed recorder left
behind is read, too; a copy is used, as SQLite writes into its folder. A rollback journal is not read: it may name other
files, which SQLite would delete.

The reader of the rosbags library is not used: it reads nothing of a truncated file ("database disk image is
malformed"), though 3,464 of 5,000 messages are intact in 70 % of a file. It also executes a crafted schema.
"""

from __future__ import annotations

import contextlib
import re
import shutil
import sqlite3
import struct
from collections.abc import Collection, Generator, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import quote

from geomid_ros.files.bags.storage import FaultError, RawMessage, Storage, TruncatedFileError
from geomid_ros.files.disk import MOST_BYTES

_MAGIC = b"SQLite format 3\0"
_HEADER = struct.Struct(">16xH6xII60xI4x")  # page size, changes, pages, changes when the pages were counted
_COLUMN = r"\s*\w+(?: (?:INTEGER|TEXT|BLOB|PRIMARY|KEY|AUTOINCREMENT|NOT|NULL))*\s*"
_PLAIN = re.compile(
    rf"CREATE TABLE \w+ ?\((?:{_COLUMN},)*{_COLUMN}\)|CREATE INDEX \w+ ON \w+ ?\( ?\w+(?: ASC| DESC)? ?\)"
)
_STEPS = 100_000  # of SQLite's virtual machine between two calls of the progress handler
# Columns since the first version of rosbag2.
_NEEDED = {"topics": {"id", "name", "type", "serialization_format"}, "messages": {"topic_id", "timestamp", "data"}}


class Database(Storage):
    """An open SQLite file."""

    recovery_hint = "'sqlite3 FILE .recover' may save it"

    def __init__(self, path: Path) -> None:
        self._topics: dict[int, tuple[str, str]] = {}
        self._end: int | None = None  # the last intact row of a truncated file
        self._steps = 0
        self._stack = contextlib.ExitStack()
        super().__init__(path)

    def close(self) -> None:
        """Close the file."""
        self._stack.close()

    def _examine(self) -> None:
        self.has_checksums = False
        header = self._header()
        self._database = sqlite3.connect(self._address(), uri=True)
        self._stack.callback(self._database.close)
        self._database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_BYTES)
        self._database.set_progress_handler(self._too_long, _STEPS)
        list(self._query(f"PRAGMA hard_heap_limit = {4 * MOST_BYTES}"))
        self._check_size(header)
        if journal := self._beside("-journal"):
            raise TruncatedFileError(f"{journal.name} holds a part of it; 'sqlite3 FILE VACUUM' merges both")
        self._check_schema()
        self._check_pages()
        self._read_topics()
        last = self._count_messages()
        if self._beside("-wal"):
            self.truncation = self._truncated(TruncatedFileError("it was not closed"), sum(self.counts.values()), last)

    def _address(self) -> str:
        """URI of the database for SQLite: a copy, if it has a write-ahead log."""
        log = self._beside("-wal")
        if log is None:
            # Immutable: SQLite neither locks the file nor looks for a journal beside it.
            return f"file:{quote(str(self._path))}?mode=ro&immutable=1"
        scratch = Path(self._stack.enter_context(TemporaryDirectory(prefix="geomid_bag_")))
        for file in (self._path, log):
            shutil.copyfile(file, scratch / file.name)
        return f"file:{quote(str(scratch / self._path.name))}?mode=ro"

    def _beside(self, ending: str) -> Path | None:
        """Companion file of SQLite with this ending; None if it is missing or empty."""
        journal = self._path.with_name(self._path.name + ending)
        return journal if journal.is_file() and journal.stat().st_size else None

    def messages(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Yield everything on ``topics`` in the order of recording. A truncated file is read in the order of writing,
        as an index, or the memory for sorting, may be missing."""
        wanted = [identity for identity, (topic, _) in self._topics.items() if topic in topics]
        if not wanted:
            return
        places = ", ".join("?" * len(wanted))
        query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({places}) ORDER BY timestamp, rowid"  # noqa: S608
        if self._end is not None:
            query = query.replace(" WHERE", f" NOT INDEXED WHERE rowid <= {self._end:d} AND")
            query = query.replace("BY timestamp, rowid", "BY rowid")
        rows = self._query(query, *wanted)
        count, last = 0, 0
        try:
            for identity, time, data in rows:
                if not isinstance(time, int) or not isinstance(data, bytes):
                    raise FaultError("a message's time is not an integer, or its data are not bytes")  # noqa: TRY301
                count, last = count + 1, time
                yield RawMessage(self._topics[identity][0], time, self._topics[identity][1], data)
        except FaultError as fault:
            raise self._damaged(fault, count, last) from fault

    def _query(self, text: str, *values: int) -> Generator[Any, None, None]:
        """Yield the rows of a query; its steps are limited in proportion to the file's size. Raises FaultError."""
        self._steps = 10 + 10 * self._size // _STEPS  # ten steps per byte
        try:
            for row in self._database.execute(text, values):  # noqa: UP028 yield from would close it twice
                yield row
        except (sqlite3.Error, UnicodeError) as error:  # its messages may quote bytes that are not text
            raise FaultError(str(error)) from error
        except MemoryError as error:
            raise FaultError("it has a row that would need more memory than is allowed") from error

    def _too_long(self) -> bool:
        """True if SQLite must stop: crafted pages can make it loop."""
        self._steps -= 1
        return self._steps < 0

    def _header(self) -> bytes:
        with self._path.open("rb") as file:
            header = file.read(_HEADER.size)
        if not (header.startswith(_MAGIC) or _MAGIC.startswith(header)):
            raise FaultError("it does not begin with an SQLite header", 0)
        return header

    def _check_size(self, header: bytes) -> None:
        """Compare the file's size with the header's page count, unless an old program changed the file."""
        if len(header) < _HEADER.size:
            raise TruncatedFileError("the file is empty" if not header else "the file ends in its first bytes", 0)
        page_size, changes, pages, changes_then = _HEADER.unpack(header)
        self._page_size = page_size if page_size > 1 else 1 << 16
        expected = pages * self._page_size
        if changes == changes_then and expected > self._size:
            raise TruncatedFileError(f"of {expected} bytes, {self._size} are there", self._size)

    def _check_schema(self) -> None:
        for name, text in self._query("SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL"):
            plain = re.sub(r"\s+", " ", text.replace('"', "")) if isinstance(text, str) else ""
            if not _PLAIN.fullmatch(plain):
                raise FaultError(f"{str(name)[:50]!r} is not a plain table or index as written by rosbag2")
        for table, needed in _NEEDED.items():
            columns = {row[1] for row in self._query(f"PRAGMA table_info({table})")}
            if not needed <= columns:
                raise FaultError(f"not a rosbag2 database: it has no table '{table}' with {', '.join(sorted(needed))}")

    def _check_pages(self) -> None:
        ((answer,),) = self._query("PRAGMA integrity_check(1)")
        if answer != "ok":
            page = re.search(r"page (\d+)", answer, re.IGNORECASE)
            offset = (int(page[1]) - 1) * self._page_size if page else None
            raise FaultError(" ".join(str(answer).split())[:200], offset)

    def _read_topics(self) -> None:
        for identity, name, kind, encoding in self._query("SELECT id, name, type, serialization_format FROM topics"):
            if not all(isinstance(text, str) for text in (name, kind, encoding)):
                raise FaultError("a topic's name or type is not text")
            self._topics[identity] = name, kind if encoding == "cdr" else f"{kind} in {encoding}"
        self.counts = dict.fromkeys(self._topics.values(), 0)

    def _count_messages(self) -> int:
        """Count the messages by topic, and find the first recording time. Returns the last one [ns]."""
        end = 0
        query = "SELECT topic_id, count(*), min(timestamp), max(timestamp) FROM messages GROUP BY 1"
        for identity, count, first, last in self._query(query):
            if identity in self._topics:
                self.counts[self._topics[identity]] += count
            if isinstance(first, int):
                self.start = first if self.start is None else min(self.start, first)
            end = max(end, last) if isinstance(last, int) else end
        return end

    def _whole(self) -> tuple[int, int]:
        """Count the readable messages in the order of writing, while row numbers rise, as damaged pages may lead back
        to others. Returns their number and the last recording time [ns]."""
        last = self._end = 0
        if not self._steps:  # it was not opened
            return 0, 0
        rows = self._query("SELECT rowid, topic_id, timestamp, data FROM messages NOT INDEXED")
        with contextlib.suppress(FaultError), contextlib.closing(rows):
            # Otherwise SQLite reads nothing of a file that is too short.
            list(self._query("PRAGMA writable_schema = ON"))
            self._check_schema()
            self._read_topics()
            for row, identity, time, data in rows:
                if row <= self._end or not isinstance(time, int) or not isinstance(data, bytes):
                    break
                self._end, last = row, max(last, time)
                if identity in self._topics:
                    self.counts[self._topics[identity]] += 1
                    self.start = time if self.start is None else min(self.start, time)
        return sum(self.counts.values()), last
