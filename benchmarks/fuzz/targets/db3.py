"""Bags in SQLite."""

from __future__ import annotations

import sqlite3
from itertools import product
from pathlib import Path
from random import Random

from benchmarks.fuzz.messages import CHANNELS, START, serialised
from benchmarks.fuzz.mutations import changed_bytes
from benchmarks.fuzz.target import require
from benchmarks.fuzz.targets.mcap import read

_COUNT = 40  # messages
_TOPICS = {
    1: "id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL",
    2: "id INTEGER PRIMARY KEY,name TEXT NOT NULL,type TEXT NOT NULL,serialization_format TEXT NOT NULL,"
    "offered_qos_profiles TEXT NOT NULL",
}
_MESSAGES = "id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL,timestamp INTEGER NOT NULL, data BLOB NOT NULL"
_INDEX = "CREATE INDEX timestamp_idx ON messages (timestamp ASC)"
_ENDLESS = (
    "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n)"
    " SELECT x AS id, 1 AS topic_id, x AS timestamp, x AS data FROM n"
)
_LARGE = "BLOB GENERATED ALWAYS AS (zeroblob(1000000000)) VIRTUAL"
_CRAFTED = (
    f"CREATE VIEW more AS {_ENDLESS}",
    f"DROP TABLE messages; CREATE VIEW messages AS {_ENDLESS}",
    f"ALTER TABLE messages ADD COLUMN more {_LARGE}",
    (
        f"DROP TABLE messages; CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data {_LARGE});"
        "INSERT INTO messages(topic_id, timestamp) VALUES(1, 1)"
    ),
    "CREATE TRIGGER t AFTER INSERT ON messages BEGIN DELETE FROM topics; END",
    "CREATE INDEX more ON messages(length(data))",
    "CREATE INDEX more ON messages(timestamp) WHERE topic_id > 0",
    "UPDATE messages SET timestamp = 'text' WHERE id = 7",
    "UPDATE messages SET data = 5 WHERE id = 7",
    "UPDATE messages SET data = zeroblob(200000) WHERE id = 7",
    "UPDATE messages SET topic_id = 99",
    "UPDATE topics SET name = CAST(x'ff00' AS TEXT)",
    "UPDATE topics SET type = 5",
    "UPDATE topics SET type = 'no_msgs/msg/Such'",
    "DROP INDEX IF EXISTS timestamp_idx",
    "DELETE FROM messages",
    "DROP TABLE topics",
    "PRAGMA writable_schema = ON; UPDATE sqlite_master SET sql = 'CREATE TABLE messages(x)' WHERE name = 'messages'",
    "PRAGMA writable_schema = ON; UPDATE sqlite_master SET rootpage = 1 WHERE name = 'messages'",
    "PRAGMA writable_schema = ON; UPDATE sqlite_master SET rootpage = 2000000000",
)
_AS_IT_IS = 0.05  # of the crafted ones


class DatabaseTarget:
    """Databases with something changed, some of them made so that reading them would take for ever."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "fuzz.db3"
        whole = [self._made(*choice) for choice in product((1, 2), (512, 4096), (True, False))]
        for data in whole:
            self._path.write_bytes(data)
            require(len(read(self._path)[0]) == _COUNT, "a whole file that cannot be read")
        self._whole = whole
        self._crafted = [self._made(2, size, True, sql) for sql in _CRAFTED for size in (512, 4096)]

    def attempt(self, random: Random) -> None:
        """Change a file, and read it."""
        data = random.choice(random.choice((self._whole, self._whole, self._crafted)))
        if random.random() > _AS_IT_IS:
            changed = changed_bytes(data, random, self._whole)
            # Mostly of the length that it says it has, else nothing else would be looked at.
            data = changed if random.random() < 0.2 else changed[: len(data)].ljust(len(data), b"\0")
        self._path.write_bytes(data)
        read(self._path)

    def _made(self, version: int, page_size: int, index: bool, sql: str = "") -> bytes:
        self._path.unlink(missing_ok=True)
        database = sqlite3.connect(self._path)
        database.execute(f"PRAGMA page_size = {page_size}")
        database.execute(f"CREATE TABLE topics({_TOPICS[version]})")
        database.execute(f"CREATE TABLE messages({_MESSAGES})")
        if index:
            database.execute(_INDEX)
        for identity, (topic, kind) in enumerate(CHANNELS):
            row = (identity + 1, topic, kind, "cdr", "")[: 3 + version]
            database.execute(f"INSERT INTO topics VALUES({', '.join('?' * len(row))})", row)
        for number in range(_COUNT):
            channel, time = (0, 0, 1, 0, 2, 3)[number % 6], START + 10**7 * number
            database.execute(
                "INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)",
                (channel + 1, time, serialised(channel, time)),
            )
        database.commit()
        database.executescript(sql)
        database.commit()
        database.close()
        return self._path.read_bytes()
