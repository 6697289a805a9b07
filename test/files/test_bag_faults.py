"""Damaged and crafted bags (cases 58 to 63): the command ends with status 2 and one error that names the file, the
place and how much could be read; and a bag that says nothing wrong is read as before."""

from __future__ import annotations

import random
import re
import sqlite3
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from commands.running import refused
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer

from benchmarks.fuzz.mcap_writer import MAGIC, Form, Message, chunk, mcap, record, text
from geomid_ros.errors import InputError
from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.bags.unpacking import MOST_BYTES

from .recordings import BAGS, TYPES, Recorded, recorded, write_bag

ROOT = Path(__file__).parents[2]
URDF = BAGS / "arm3.urdf"
MESSAGES = recorded(BAGS / "arm3")
PERIOD = 10_000_000
MEMORY = 400_000_000  # bytes that opening a crafted file may take, of 591 MB that it would unpack to
FLIPS = 150

Content = list[tuple[str, int, bytes]]


def content(path: Path) -> Content:
    """All that a bag says."""
    with Bag(path) as bag:
        return list(bag.raw_messages(list(bag.topics)))


def by_rosbags(path: Path) -> Content:
    """The same as another program reads it."""
    with Reader(path) as reader:
        return [(connection.topic, time, bytes(raw)) for connection, time, raw in reader.messages()]


def error_of(path: Path) -> str:
    """What is wrong with a bag."""
    with pytest.raises(InputError) as caught:
        content(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def file_of(form: Form, count: int = 400) -> bytes:
    """The small arm's joint states in an mcap file."""
    states = [item for item in MESSAGES if item.topic == "/joint_states"][:count]
    raw = [Message(0, item.time, bytes(TYPES.serialize_cdr(item.message, item.kind))) for item in states]
    return mcap([("/joint_states", "sensor_msgs/msg/JointState")], raw, form)


def chunk_ends(data: bytes) -> list[int]:
    """Where the chunks of an mcap file end."""
    ends, position = [], len(MAGIC)
    while data[position] != 0x02:
        (length,) = struct.unpack_from("<Q", data, position + 1)
        kind, position = data[position], position + 9 + length
        ends += [position] if kind == 0x06 else []
    return ends


def database(folder: Path, messages: list[Recorded] = MESSAGES) -> Path:
    """The small arm's bag in SQLite: the file."""
    return write_bag(folder / "whole", messages, StoragePlugin.SQLITE3) / "whole.db3"


class TestTruncated:
    """Case 58."""

    @pytest.mark.parametrize("form", [Form(), Form(method="lz4", checksums=False), Form(chunk=0), Form(summary=False)])
    def test_as_many_messages_as_are_in_whole_chunks_are_told_of(self, form: Form, tmp_path: Path) -> None:
        data = file_of(form)
        ends = chunk_ends(data)
        generator = random.Random(1)
        for cut in [*(generator.randrange(len(data)) for _ in range(20)), len(data) - 1]:
            path = tmp_path / "cut.mcap"
            path.write_bytes(data[:cut])
            message = error_of(path)
            told = re.search(r"(\d+) messages, up to ([\d.]+) s", message)
            if form.chunk:
                count = 10 * sum(end <= cut for end in ends)
                assert (int(told[1]) if told else 0) == count
                assert not told or float(told[2]) == pytest.approx(1.7e9 + (count - 1) * PERIOD * 1e-9)
                assert int(re.search(r"at byte (\d+)", message)[1]) <= cut
            elif told:
                assert 0 < int(told[1]) <= 400 * cut / len(data) + 1

    def test_a_database_tells_of_what_is_left(self, tmp_path: Path) -> None:
        whole = database(tmp_path).read_bytes()
        counts = []
        for share in (0.3, 0.6, 0.9):
            path = tmp_path / "cut.db3"
            path.write_bytes(whole[: int(share * len(whole))])
            told = re.search(r"(\d+) messages, up to", error_of(path))
            counts.append(int(told[1]) if told else 0)
        assert counts == sorted(counts)
        assert 0 < counts[-1] < len(MESSAGES)

    def test_a_database_whose_recorder_was_killed_is_not_whole(self, tmp_path: Path) -> None:
        """Its last messages are in a journal beside it."""
        path = database(tmp_path, MESSAGES[:50])
        recorder = sqlite3.connect(path)
        recorder.execute("PRAGMA journal_mode = WAL")
        recorder.execute(
            "INSERT INTO messages(topic_id, timestamp, data) SELECT topic_id, timestamp, data FROM messages"
        )
        recorder.commit()
        killed = tmp_path / "killed.db3"
        for ending in ("", "-wal"):
            Path(f"{killed}{ending}").write_bytes(Path(f"{path}{ending}").read_bytes())
        recorder.close()
        message = error_of(killed)
        assert "killed.db3-wal has a part of it" in message
        assert "50 messages" in message
        with sqlite3.connect(killed) as repaired:
            repaired.execute("VACUUM")
        repaired.close()
        assert len(content(killed)) == 100


class TestFlippedBit:
    """Case 59."""

    @pytest.mark.parametrize("form", [Form(), Form(method=""), Form(chunk=0), Form(chunk=400, summary=False)])
    def test_with_checksums_it_is_found_or_changes_nothing(self, form: Form, tmp_path: Path) -> None:
        data = file_of(form, 60)
        path = tmp_path / "flipped.mcap"
        path.write_bytes(data)
        whole = content(path)
        found, generator = 0, random.Random(2)
        for _ in range(FLIPS):
            damaged = bytearray(data)
            damaged[generator.randrange(len(data))] ^= 1 << generator.randrange(8)
            path.write_bytes(damaged)
            try:
                assert content(path) == whole
            except InputError as error:
                assert "flipped.mcap" in str(error)  # noqa: PT017 either outcome is right
                found += 1
        assert found > 0.9 * FLIPS

    @pytest.mark.parametrize("robot", ["arm3", "arm7"])
    def test_shipped_bags_are_protected(self, robot: str, tmp_path: Path) -> None:
        data = (BAGS / robot / f"{robot}.mcap").read_bytes()
        generator, path = random.Random(3), tmp_path / "flipped.mcap"
        whole = content(BAGS / robot)
        for _ in range(20):
            damaged = bytearray(data)
            damaged[generator.randrange(len(data) - 1)] ^= 1 << generator.randrange(8)
            path.write_bytes(damaged)
            try:
                assert content(path) == whole
            except InputError:
                continue

    def test_a_chunk_that_passes_for_something_else_is_missed(self, tmp_path: Path) -> None:
        """Without checksums: the kind of a chunk's record is flipped; the summary has the number of messages."""
        data = bytearray(file_of(Form(checksums=False)))
        second = chunk_ends(bytes(data))[0]
        assert data[second] == 0x06
        data[second] = 0x86  # a private record, to be passed over
        path = tmp_path / "less.mcap"
        path.write_bytes(data)
        assert "its statistics count 400 messages, it has 390" in error_of(path)

    def test_a_databases_time_that_contradicts_its_index_is_found(self, tmp_path: Path) -> None:
        path = database(tmp_path)
        data = bytearray(path.read_bytes())
        time = struct.pack(">Q", MESSAGES[800].time)
        places = [found.start() for found in re.finditer(re.escape(time), bytes(data))]
        assert len(places) > 1, "once in the row, once in the index"
        data[places[0] + 7] ^= 4
        path.write_bytes(data)
        assert re.search(r"index|order", error_of(path))


def without_metadata(folder: Path) -> Path:
    bag = write_bag(folder / "bag", MESSAGES)
    (bag / "metadata.yaml").unlink()
    return bag


def with_metadata(**fields: object) -> Callable[[Path], Path]:
    """A bag of which ``metadata.yaml`` says something else."""

    def make(folder: Path) -> Path:
        bag = write_bag(folder / "bag", MESSAGES[:50])
        document = yaml.safe_load((bag / "metadata.yaml").read_text())
        document["rosbag2_bagfile_information"].update(fields)
        (bag / "metadata.yaml").write_text(yaml.safe_dump(document))
        return bag

    return make


def file(name: str, data: bytes) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / name).write_bytes(data)
        return folder / name

    return make


def alias_bomb(folder: Path) -> Path:
    bag = write_bag(folder / "bag", MESSAGES[:50])
    levels = "".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 10))
    (bag / "metadata.yaml").write_text(f"a0: &a0 [x]\n{levels}rosbag2_bagfile_information: {{compression_format: *a9}}")
    return bag


# Case, how it is made, and what the error says.
WRONG: dict[str, tuple[Callable[[Path], Path], str]] = {
    "without metadata": (without_metadata, r"without metadata.yaml.*bag.mcap.*ros2 bag reindex"),
    "folder of nothing": (lambda folder: folder, "without metadata.yaml.*record it again"),
    "empty mcap": (file("a.mcap", b""), "at byte 0, the file is empty"),
    "empty db3": (file("a.db3", b""), "at byte 0, the file is empty"),
    "db3 called mcap": (file("a.mcap", b"SQLite format 3\0" + bytes(100)), "at byte 0, .*as an mcap file"),
    "mcap called db3": (file("a.db3", file_of(Form(), 10)), "at byte 0, .*as an SQLite database"),
    "a ROS 1 bag": (file("a.bag", b"#ROSBAG V2.0\n"), "wrong type; expected a bag's folder, or a file"),
    "a ROS 1 bag called mcap": (file("a.mcap", b"#ROSBAG V2.0\n" + bytes(100)), "at byte 0, .*as an mcap file"),
    "an mcap of ROS 1": (file("a.mcap", file_of(Form(), 10).replace(text("ros2"), text("ros1"))), "profile 'ros1'"),
    "another database": (file("a.db3", b""), "the file is empty"),
    "the file is missing": (with_metadata(relative_file_paths=["other.mcap"]), "other.mcap: .*missing"),
    "a path outside": (with_metadata(relative_file_paths=["../../../../etc/passwd"]), "bag/passwd: .*missing"),
    "the format is another": (with_metadata(storage_identifier="hdf5"), "metadata.yaml: .*hdf5"),
    "the compression is another": (with_metadata(compression_mode="FILE", compression_format="rar"), "rar"),
    "files are a number": (with_metadata(relative_file_paths=3), "metadata.yaml: cannot be read"),
    "a file is a list": (with_metadata(relative_file_paths=[["a"]]), "metadata.yaml: cannot be read"),
    "aliases": (alias_bomb, "metadata.yaml: .*aliases are not allowed"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_no_bag_is_named(case: str, tmp_path: Path) -> None:
    """Cases 60, 61 and 63."""
    make, message = WRONG[case]
    path = make(tmp_path)
    out = tmp_path / "out"
    shown = " ".join(refused("identify", path, "--urdf", URDF, "--out", out).split())
    assert re.search(message, shown), shown
    assert str(path) in shown
    assert not out.exists()


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_bag_without_messages_is_refused(storage: StoragePlugin, tmp_path: Path) -> None:
    with Writer(tmp_path / "bag", version=9, storage_plugin=storage) as writer:
        writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=TYPES)
    assert content(tmp_path / "bag") == []
    assert "no messages" in refused("identify", tmp_path / "bag", "--urdf", URDF, "--out", tmp_path / "out")


def test_the_command_says_how_much_is_left(tmp_path: Path) -> None:
    (tmp_path / "cut.mcap").write_bytes(file_of(Form())[:20_000])
    out = tmp_path / "out"
    message = refused("identify", tmp_path / "cut.mcap", "--urdf", URDF, "--out", out)
    assert re.search(
        r"at byte \d+, .*Only a part can be read: \d+ messages, up to 17000\d+\.\d+ s.*mcap recover", message
    )
    assert not out.exists()


OPEN_AND_MEASURE = """
import resource, sys
from pathlib import Path
from geomid_ros.errors import InputError
from geomid_ros.files.bags.bag import Bag
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    Bag(Path(sys.argv[1]))
except InputError as error:
    print(error)
print(1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before))
"""
ZEROS = bytes(591_000_000)


def bomb(method: str) -> bytes:
    """A file of few kilobytes with a chunk that unpacks to 591 MB, as one message."""
    head = record(3, struct.pack("<H", 1) + text("std_msgs/msg/String") + text("ros2msg") + text(""))
    head += record(4, struct.pack("<HH", 0, 1) + text("/a") + text("cdr") + struct.pack("<I", 0))
    told = chunk(head + record(5, bytes(22) + ZEROS), method, False)
    return MAGIC + record(1, text("ros2") + text("")) + told


def lying_bomb() -> bytes:
    """The same, which says that it unpacks to little."""
    whole = chunk(record(0x80, ZEROS), "zstd", False, size=1000)
    return MAGIC + record(1, text("ros2") + text("")) + whole


ENDLESS = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n)"
CRAFTED_TABLES = {
    "endless": f"DROP TABLE messages; CREATE VIEW messages AS {ENDLESS}"
    " SELECT x AS id, 1 AS topic_id, x AS timestamp, x AS data FROM n",
    "generated": "ALTER TABLE messages ADD COLUMN more BLOB GENERATED ALWAYS AS (zeroblob(900000000)) VIRTUAL",
    "trigger": "CREATE TRIGGER t AFTER INSERT ON messages BEGIN DELETE FROM topics; END",
    "expression": "CREATE INDEX i ON messages(abs(timestamp))",
}


class TestCrafted:
    """Case 62."""

    @pytest.mark.parametrize(
        ("name", "data", "message"),
        [
            ("zstd.mcap", lambda: bomb("zstd"), f"591000\\d+ bytes are packed in \\d+, more than the {MOST_BYTES}"),
            ("lz4.mcap", lambda: bomb("lz4"), "more than"),
            ("lying.mcap", lying_bomb, "should unpack to 1000 bytes unpacks to more"),
        ],
        ids=["zstd", "lz4", "lying"],
    )
    def test_what_would_fill_the_memory_is_refused_before(
        self, name: str, data: Callable[[], bytes], message: str, tmp_path: Path
    ) -> None:
        path = tmp_path / name
        path.write_bytes(data())
        assert path.stat().st_size < 3_000_000
        command = [sys.executable, "-c", OPEN_AND_MEASURE, str(path)]
        result = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT, timeout=60)
        shown, memory = result.stdout.splitlines()
        assert re.search(message, shown)
        assert "at byte" in shown
        assert int(memory) < MEMORY

    @pytest.mark.parametrize("case", CRAFTED_TABLES)
    def test_databases_that_are_programs_are_refused(self, case: str, tmp_path: Path) -> None:
        path = database(tmp_path, MESSAGES[:50])
        connection = sqlite3.connect(path)
        connection.executescript(CRAFTED_TABLES[case])
        connection.close()
        assert "not of the plain tables and indices" in error_of(path)

    def test_a_packed_file_that_unpacks_to_too_much_is_refused(self, tmp_path: Path) -> None:
        bag = with_metadata(compression_mode="FILE", compression_format="zstd")(tmp_path)
        zstd = pytest.importorskip("backports.zstd")
        (bag / "bag.mcap").write_bytes(zstd.compress(bytes(50_000_000)))
        with pytest.raises(InputError, match="more than 1000 times its size"):
            content(bag)

    def test_messages_of_chunks_that_all_overlap_are_bounded(
        self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        monkeypatch.setattr("geomid_ros.files.bags.mcap._MOST_PENDING", 40_000)
        messages = [Message(0, time, bytes(100)) for index in range(50) for time in (0 if index else 1, 10**9 + index)]
        path = tmp_path / "mixed.mcap"
        path.write_bytes(mcap([("/a", "std_msgs/msg/String")], messages, Form(chunk=2)))
        assert content(path)[:2] == [("/a", 0, bytes(100))] * 2
        monkeypatch.setattr("geomid_ros.files.bags.mcap._MOST_PENDING", 10_000)
        assert "overlap in time" in error_of(path)

    def test_what_a_bag_calls_its_topics_does_not_reach_the_terminal(self, tmp_path: Path) -> None:
        path = tmp_path / "colour.mcap"
        path.write_bytes(mcap([("/\x1b[2Jgone", "std_msgs/msg/String")], [], Form()))
        shown = refused("identify", path, "--urdf", URDF, "--out", tmp_path / "out")
        assert "\x1b" not in shown
        assert "/\\x1b[2Jgone" in shown


class TestWhole:
    """What is right is read as other programs read it."""

    @pytest.mark.parametrize("method", ["", "zstd", "lz4"])
    @pytest.mark.parametrize("size", [0, 1, 7, 400])
    def test_every_form_of_an_mcap_file(self, size: int, method: str, tmp_path: Path) -> None:
        path = tmp_path / "a.mcap"
        path.write_bytes(file_of(Form(size, method)))
        assert len(content(path)) == 400
        path.write_bytes(file_of(Form(size, method, checksums=False, summary=False)))
        assert content(path) == by_rosbags(path)

    @pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
    @pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.FILE, CompressionMode.MESSAGE])
    def test_every_compression_of_a_bag(self, mode: CompressionMode, storage: StoragePlugin, tmp_path: Path) -> None:
        writer = Writer(tmp_path / "bag", version=9, storage_plugin=storage)
        writer.set_compression(mode, CompressionFormat.ZSTD)
        with writer:
            connection = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=TYPES)
            for item in MESSAGES[1:200:2]:
                if item.topic == "/joint_states":
                    writer.write(connection, item.time, bytes(TYPES.serialize_cdr(item.message, item.kind)))
        assert content(tmp_path / "bag") == by_rosbags(tmp_path / "bag")
        assert content(tmp_path / "bag")

    def test_chunks_that_overlap_are_read_in_the_order_of_recording(self, tmp_path: Path) -> None:
        times = list(range(1000, 1200))
        random.Random(4).shuffle(times)
        path = tmp_path / "mixed.mcap"
        path.write_bytes(
            mcap([("/a", "std_msgs/msg/String")], [Message(0, time, bytes(8)) for time in times], Form(chunk=9))
        )
        assert [time for _, time, _ in content(path)] == sorted(times)
