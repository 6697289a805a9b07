"""Bags in mcap."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from random import Random
from typing import TypeAlias

from benchmarks.fuzz.mcap_writer import Form, Message, mcap
from benchmarks.fuzz.messages import CHANNELS, START, serialised
from benchmarks.fuzz.mutations import changed_bytes
from benchmarks.fuzz.target import require
from geomid_ros.files.bags.bag import Bag

_Content: TypeAlias = list[tuple[str, int, bytes]]
_COUNT = 40  # messages
_MESSAGES = [
    Message(channel, START + 10**7 * index, serialised(channel, START + 10**7 * index))
    for index, channel in ((index, (0, 0, 1, 0, 2, 3)[index % 6]) for index in range(_COUNT))
]
_FORMS = [Form(*choice) for choice in product((0, 1, 7, _COUNT), ("", "zstd", "lz4"), (True, False), (True, False))]
_CRAFTED = 0.3  # of the inputs have right checksums around wrong contents


def read(path: Path) -> tuple[_Content, bool, bool]:
    """All messages of a bag, whether it says that these are all, and that they are checked; their fields have been
    read, too."""
    with Bag(path) as bag:
        topics = list(bag.topics)
        bag.count(topics)
        for _ in bag.messages(topics):
            pass
        content = [(message.topic, message.time, message.data) for message in bag.raw_messages(topics)]
        return content, not bag.warnings, bag.has_checksums


class McapTarget:
    """Files with something changed; where checksums were not made anew, they must tell of every changed value, and the
    reader of every missing one."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "fuzz.mcap"
        self._files = [mcap(CHANNELS, _MESSAGES, form) for form in _FORMS]
        self._true = sorted((CHANNELS[m.channel][0], m.time, m.data) for m in _MESSAGES)
        for data in self._files:
            self._check(data)

    def attempt(self, random: Random) -> None:
        """Change a file, and read it."""
        form = random.randrange(len(_FORMS))
        if random.random() < _CRAFTED:
            self._read(mcap(CHANNELS, _MESSAGES, _FORMS[form], lambda content: changed_bytes(content, random)))
            return
        data = changed_bytes(self._files[form], random, self._files)
        if _FORMS[form].checksums:
            self._check(data)
        else:
            self._read(data)

    def _read(self, data: bytes) -> tuple[_Content, bool, bool]:
        self._path.write_bytes(data)
        return read(self._path)

    def _check(self, data: bytes) -> None:
        found, whole, checked = self._read(data)
        require(not checked or set(found) <= set(self._true), "a value has changed under its checksum")
        require(not whole or sorted(found) == self._true, "a message is missing, and nothing says so")
