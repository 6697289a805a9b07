"""Damaged and crafted bags (cases 58 to 63): the command ends with status 2 and one error that names the file, the
place and how much could be read; and a bag that says nothing wrong is read as before."""

from __future__ import annotations

import random
import re
import shlex
import shutil
import sqlite3
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import pytest
import yaml
from commands.running import NO_CHOICE, done, found_only, refused
from commands.running import read as document_of
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from benchmarks.fuzz.mcap_writer import MAGIC, Form, Message, chunk, mcap, record, text
from geomid_ros.errors import InputError
from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.disk import MOST_BYTES

from .recordings import BAGS, TYPES, Recorded, recorded, write_bag

ROOT = Path(__file__).parents[2]
URDF = BAGS / "arm3.urdf"
MESSAGES = recorded(BAGS / "arm3")
MEMORY = 200_000_000  # bytes that opening a crafted file may take, of 300 MB that it would unpack to
FLIPS = 80

Content = list[tuple[str, int, bytes]]


def content(path: Path) -> Content:
    """All that a bag says."""
    with Bag(path) as bag:
        return content_of(bag)


def content_of(bag: Bag) -> Content:
    return [(message.topic, message.time, message.data) for message in bag.raw_messages(list(bag.topics))]


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


def whole_ends(data: bytes, form: Form, messages: Content) -> list[int]:
    """Of each message the byte of the file with which it is whole; of a packed one, with which its chunk is."""
    if form.chunk and form.method:
        return [end for end in chunk_ends(data) for _ in range(form.chunk)]
    return [data.index(raw) + len(raw) for _, _, raw in messages]


class TestTruncated:
    """Cases 58 and 97."""

    @pytest.mark.parametrize(
        "form",
        [
            Form(),
            Form(method="lz4", checksums=False),
            Form(method=""),
            Form(chunk=0, summary=False),
            Form(chunk=400, method="", checksums=False, summary=False),
        ],
    )
    def test_all_messages_that_are_whole_are_read(self, form: Form, tmp_path: Path) -> None:
        data = file_of(form)
        path = tmp_path / "cut.mcap"
        path.write_bytes(data)
        everything = content(path)
        ends = whole_ends(data, form, everything)
        assert len(everything) == len(ends) == 400
        assert everything == by_rosbags(path)
        generator = random.Random(1)
        for cut in [*(generator.randrange(len(data)) for _ in range(20)), len(data) - 1]:
            path.write_bytes(data[:cut])
            count = sum(end <= cut for end in ends)
            if not count:
                assert "it has no intact message" in error_of(path)
                continue
            with Bag(path) as bag:
                found = content_of(bag)
                (warning,) = bag.warnings
            assert len(found) >= count if form.method and form.chunk else len(found) == count
            assert found == everything[: len(found)]
            assert f"its {len(found)} intact messages are read, up to {found[-1][1] * 1e-9:.3f} s" in warning
            assert int(re.search(r"truncated at byte (\d+)", warning)[1]) <= cut

    def test_a_file_that_ends_in_zeros_is_cut_off(self, tmp_path: Path) -> None:
        """As a disk may have them that lost its power."""
        data = file_of(Form())
        with Bag(file("cut.mcap", data[: chunk_ends(data)[3]] + bytes(100_000))(tmp_path)) as bag:
            assert bag.count(list(bag.topics)) == 40
            assert "the file ends before its footer" in bag.warnings[0]

    def test_a_database_is_read_up_to_the_first_missing_page(self, tmp_path: Path) -> None:
        path = database(tmp_path)
        everything, whole = content(path), path.read_bytes()
        by_time = sorted(everything, key=lambda item: item[1])
        counts = []
        for share in (0.3, 0.6, 0.9):
            path = tmp_path / "cut.db3"
            path.write_bytes(whole[: int(share * len(whole))])
            with Bag(path) as bag:
                found = content_of(bag)
                assert f"its {len(found)} intact messages are read" in bag.warnings[0]
                assert f"truncated at byte {path.stat().st_size}" in bag.warnings[0]
            counts.append(len(found))
            assert sorted(found, key=lambda item: item[1]) == by_time[: len(found)]
            # Rows are written one after the other: what is there of the file is there of them, but for its indices.
            assert len(found) > 0.5 * share * len(everything)
        assert counts == sorted(counts)
        assert counts[-1] < len(everything)

    def test_what_is_in_a_killed_recorders_log_is_read(self, tmp_path: Path) -> None:
        """Its last messages are in a write-ahead log, beside the database; neither of them is changed."""
        path = database(tmp_path, MESSAGES[:50])
        recorder = sqlite3.connect(path)
        recorder.execute("PRAGMA journal_mode = WAL")
        recorder.execute(
            "INSERT INTO messages(topic_id, timestamp, data) SELECT topic_id, timestamp, data FROM messages"
        )
        recorder.commit()
        folder = tmp_path / "copy"
        folder.mkdir()
        killed = folder / "killed.db3"
        for ending in ("", "-wal"):
            Path(f"{killed}{ending}").write_bytes(Path(f"{path}{ending}").read_bytes())
        recorder.close()
        before = {file.name: file.read_bytes() for file in folder.iterdir()}
        with Bag(killed) as bag:
            assert len(content_of(bag)) == 100
            assert "it was not closed; its 100 intact messages are read" in bag.warnings[0]
        assert {file.name: file.read_bytes() for file in folder.iterdir()} == before

    def test_a_rollback_journal_is_not_obeyed(self, tmp_path: Path) -> None:
        """It may name files that SQLite would delete."""
        path = database(tmp_path, MESSAGES[:50])
        journal = Path(f"{path}-journal")
        journal.write_bytes(b"\xd9\xd5\x05\xf9 \xa1c\xd7" + bytes(600))
        with Bag(path) as bag:
            assert len(content_of(bag)) == 50
            assert f"{journal.name} holds a part of it" in bag.warnings[0]
        assert journal.exists()

    @pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
    @pytest.mark.parametrize("left", [0.5, 0.0], ids=["half of it", "nothing of it"])
    def test_the_last_file_of_a_split_bag_is_torn(self, left: float, storage: StoragePlugin, tmp_path: Path) -> None:
        bag = split(tmp_path / "bag", storage, [MESSAGES[:600], MESSAGES[600:1200]])
        whole = content(bag)
        last = min(bag.glob("bag_1*"))
        last.write_bytes(last.read_bytes()[: int(left * last.stat().st_size)])
        with Bag(bag) as opened:
            found = content_of(opened)
            assert len(opened.warnings) == 1
            assert last.name in opened.warnings[0]
        assert len(found) == 600 if left == 0.0 else 600 < len(found) < 1200
        assert sorted(found, key=lambda item: item[1]) == sorted(whole, key=lambda item: item[1])[: len(found)]

    def test_a_recorder_that_was_killed_leaves_no_metadata(self, tmp_path: Path) -> None:
        bag = write_bag(tmp_path / "bag", MESSAGES)
        whole = content(bag)
        (bag / "metadata.yaml").unlink()
        with Bag(bag) as opened:
            assert content_of(opened) == whole
            assert (
                "has no metadata.yaml (was its recorder killed?); reading its files: bag.mcap" in (opened.warnings[0])
            )

    def test_the_command_reads_what_is_whole_and_says_so(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """With status 0. Case 98: that there are no checksums is not said, as nothing can be done about it."""
        found_only(monkeypatch)
        data = file_of(Form(checksums=False), 600)
        path = tmp_path / "cut.mcap"
        path.write_bytes(data[: chunk_ends(data)[49] + 50])
        shown = " ".join(done("identify", path, "--urdf", URDF, *NO_CHOICE, "--out", tmp_path / "out").split())
        assert re.search(r"Warning: \S*cut.mcap: truncated at byte \d+", shown)
        assert "its 500 intact messages are read" in shown
        document = document_of(tmp_path / "out")
        (warning,) = document["warnings"]
        assert "truncated at byte" in warning
        assert not any("CRC" in note for note in document["notes"])


def split(folder: Path, storage: StoragePlugin, parts: list[list[Recorded]]) -> Path:
    """A bag of several files."""
    for index, part in enumerate(parts):
        one = write_bag(folder.with_name(f"{folder.name}_{index}"), part, storage)
        (file,) = (path for path in one.iterdir() if path.suffix != ".yaml")
        folder.mkdir(exist_ok=True)
        file.rename(folder / file.name)
    names = sorted(path.name for path in folder.iterdir())
    (one / "metadata.yaml").rename(folder / "metadata.yaml")
    return described(folder, relative_file_paths=names)


def described(bag: Path, **fields: object) -> Path:
    """The bag, of which ``metadata.yaml`` says something else."""
    document = yaml.safe_load((bag / "metadata.yaml").read_text())
    document["rosbag2_bagfile_information"].update(fields)
    (bag / "metadata.yaml").write_text(yaml.safe_dump(document))
    return bag


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
                with Bag(path) as bag:
                    read = content_of(bag)
            except InputError as error:
                assert "flipped.mcap" in str(error)  # noqa: PT017 either outcome is right
                found += 1
                continue
            assert read == whole[: len(read)]
            assert len(read) == len(whole) or bag.warnings, "a length was changed: as if the file ended there"
            found += bool(bag.warnings)
        assert found > 0.9 * FLIPS

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


def with_metadata(**fields: object) -> Callable[[Path], Path]:
    """Makes such a bag."""
    return lambda folder: described(write_bag(folder / "bag", MESSAGES[:50]), **fields)


def file(name: str, data: bytes) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / name).write_bytes(data)
        return folder / name

    return make


def two_formats(folder: Path) -> Path:
    bag = folder / "bag"
    bag.mkdir()
    (bag / "a.mcap").write_bytes(file_of(Form(), 10))
    (bag / "b.db3").write_bytes(b"SQLite format 3")
    return bag


# Case, how it is made, and what the error says.
WRONG: dict[str, tuple[Callable[[Path], Path], str]] = {
    "folder of nothing": (lambda folder: folder, "without metadata.yaml.*name a bag's folder"),
    "two formats without metadata": (two_formats, "without metadata.yaml.*one of its files"),
    "empty mcap": (file("a.mcap", b""), "at byte 0, the file is empty"),
    "no mcap": (file("a.mcap", bytes(100)), "at byte 0, .*with an MCAP header"),
    "no db3": (file("a.db3", bytes(100)), "at byte 0, .*with an SQLite header"),
    "a ROS 1 bag": (file("a.bag", b"#ROSBAG V2.0\n"), "a bag of ROS 1.*rosbags-convert --src .*a.bag --dst .*a "),
    "a text": (file("a.md", b"# Bag\n"), "wrong type; expected a bag's folder, or a file"),
    "an mcap of ROS 1": (file("a.mcap", file_of(Form(), 10).replace(text("ros2"), text("ros1"))), "profile is 'ros1'"),
    "the file is missing": (with_metadata(relative_file_paths=["other.mcap"]), "other.mcap: .*missing"),
    "a path outside": (with_metadata(relative_file_paths=["../../../../etc/passwd"]), "bag/passwd: .*missing"),
    "the format is another": (with_metadata(storage_identifier="hdf5"), "metadata.yaml: .*hdf5"),
    "the compression is another": (with_metadata(compression_mode="FILE", compression_format="rar"), "rar"),
    "a file is a list": (with_metadata(relative_file_paths=[["a"]]), "metadata.yaml: cannot be read"),
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


def test_a_bag_is_what_its_first_bytes_say(tmp_path: Path) -> None:
    for name in ("a.db3", "a.bag", "a"):
        assert len(content(file(name, file_of(Form(), 10))(tmp_path))) == 10


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_bag_without_messages_is_refused(storage: StoragePlugin, tmp_path: Path) -> None:
    with Writer(tmp_path / "bag", version=9, storage_plugin=storage) as writer:
        writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=TYPES)
    assert content(tmp_path / "bag") == []
    assert "no messages" in refused("identify", tmp_path / "bag", "--urdf", URDF, "--out", tmp_path / "out")


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
ZEROS = bytes(300_000_000)


def bomb(method: str) -> bytes:
    """A file of few kilobytes with a chunk that unpacks to 300 MB, as one message."""
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
        ("data", "message"),
        [
            (lambda: bomb("zstd"), f"300000\\d+ bytes unpacked from \\d+, more than the maximum of {MOST_BYTES}"),
            (lambda: bomb("lz4"), "more than"),
            (lying_bomb, "expected 1000 unpacked bytes, found more"),
        ],
        ids=["zstd", "lz4", "lying"],
    )
    def test_what_would_fill_the_memory_is_refused_before(
        self, data: Callable[[], bytes], message: str, tmp_path: Path
    ) -> None:
        path = tmp_path / "bomb.mcap"
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
        assert "not a plain table or index" in error_of(path)

    def test_what_a_bag_calls_its_topics_does_not_reach_the_terminal(self, tmp_path: Path) -> None:
        path = tmp_path / "colour.mcap"
        path.write_bytes(mcap([("/\x1b[2Jgone", "std_msgs/msg/String")], [], Form()))
        shown = refused("identify", path, "--urdf", URDF, "--out", tmp_path / "out")
        assert "\x1b" not in shown
        assert "/\\x1b[2Jgone" in shown


@pytest.mark.usefixtures("found_only")
class TestAsFound:
    """Cases 99, 100 and 106: recordings as people have them."""

    def test_the_command_for_a_bag_of_ros_1_makes_one_that_is_read(self, tmp_path: Path) -> None:
        bag = ros1_bag(tmp_path / "old one.bag", MESSAGES[:600])
        message = refused("identify", bag, "--urdf", URDF, "--out", tmp_path / "out")
        command = shlex.split(" ".join(message.split()).partition("convert it with: ")[2])
        assert command[0] == "rosbags-convert"
        rosbags_convert(command[1:])
        states = [item for item in MESSAGES[:600] if item.topic == "/joint_states"]
        with Bag(tmp_path / "old one") as converted:
            found = [(time, message) for _, time, message in converted.messages(["/joint_states"])]
        for (time, message), item in zip(found, states, strict=True):
            assert (time, message.name) == (item.time, item.message.name)
            assert message.header.stamp == item.message.header.stamp
            assert message.effort.tolist() == item.message.effort.tolist()

    def test_a_folder_of_bags_is_all_of_them(self, tmp_path: Path) -> None:
        write_bag(tmp_path / "runs" / "b", MESSAGES[1200:2400])
        write_bag(tmp_path / "runs" / "a", MESSAGES[:1200])
        (tmp_path / "runs" / "notes").mkdir()
        options = ("--urdf", URDF, *NO_CHOICE, "--no-report", "--out")
        done("identify", tmp_path / "runs", *options, tmp_path / "one")
        done("identify", *(tmp_path / "runs" / name for name in "ab"), *options, tmp_path / "two")
        one, two = (document_of(tmp_path / name) for name in ("one", "two"))
        assert one["links"] == two["links"]
        assert one["rows"] == two["rows"]
        with pytest.raises(InputError, match=r"not a rosbag; name one of its bags \(.*runs/a\)"):
            Bag(tmp_path / "runs")

    @pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
    def test_files_listed_in_another_order_are_read_by_time(self, storage: StoragePlugin, tmp_path: Path) -> None:
        parts = [MESSAGES[:300], MESSAGES[300:600], MESSAGES[600:900]]
        bag = split(tmp_path / "bag", storage, parts)
        whole = content(bag)
        assert [time for _, time, _ in whole] == sorted(item.time for item in MESSAGES[:900])
        names = sorted((path.name for path in bag.glob("bag_*")), reverse=True)
        assert content(described(bag, relative_file_paths=names)) == whole

    def test_what_would_fill_the_disk_is_refused_before(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
        """More than 300 times its size, or more than there is room for beside 500 MB that others may need."""
        bag = with_metadata(compression_mode="FILE", compression_format="zstd")(tmp_path)
        zstd, written, remove = pytest.importorskip("backports.zstd"), [], shutil.rmtree
        (bag / "bag.mcap").write_bytes(zstd.compress(bytes(50_000_000)))
        with pytest.raises(InputError, match="more than 300 times its size"):
            content(bag)
        (bag / "bag.mcap").write_bytes(zstd.compress(random.Random(1).randbytes(50_000) * 200))
        usage = shutil.disk_usage(tmp_path)._replace(free=502_000_000)
        monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
        monkeypatch.setattr("geomid_ros.files.bags.storage.shutil.disk_usage", lambda _: usage)

        def measured(path: str, *arguments: object, **named: object) -> None:
            written.append(sum(file.stat().st_size for file in Path(path).iterdir()))
            remove(path, *arguments, **named)

        monkeypatch.setattr("tempfile._shutil.rmtree", measured)
        with pytest.raises(InputError, match=r"bag.mcap: .*no room to unpack it; set TMPDIR"):
            content(bag)
        assert 0 < max(written) <= 2_000_000


def ros1_bag(path: Path, messages: list[Recorded]) -> Path:
    """A bag of ROS 1 with the joint states among these messages."""
    types = get_typestore(Stores.ROS1_NOETIC)
    header, time = types.types["std_msgs/msg/Header"], types.types["builtin_interfaces/msg/Time"]
    kind = "sensor_msgs/msg/JointState"
    with Ros1Writer(path) as writer:
        connection = writer.add_connection("/joint_states", kind, typestore=types)
        for sequence, item in enumerate(messages):
            if item.topic == "/joint_states":
                message, stamp = item.message, item.message.header.stamp
                head = header(sequence, time(stamp.sec, stamp.nanosec), "")
                state = types.types[kind](head, message.name, message.position, message.velocity, message.effort)
                writer.write(connection, item.time, bytes(types.serialize_ros1(state, kind)))
    return path


def rosbags_convert(arguments: list[str]) -> None:
    """Run the command of that name, which comes with the package that we read messages with."""
    code = "import sys; from rosbags.convert.__main__ import main; sys.exit(main())"
    subprocess.run([sys.executable, "-c", code, *arguments], check=True, capture_output=True, timeout=60)


class TestWhole:
    """What is right is read as other programs read it."""

    @pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
    @pytest.mark.parametrize("mode", ["MESSAGE", "FILE"])
    @pytest.mark.parametrize("method", ["zstd", "lz4"])
    def test_every_compression_of_a_bag(self, method: str, mode: str, storage: StoragePlugin, tmp_path: Path) -> None:
        pack = {"zstd": pytest.importorskip("backports.zstd").compress, "lz4": lz4.frame.compress}[method]
        raw = [bytes(TYPES.serialize_cdr(item.message, item.kind)) for item in MESSAGES[1:160:2]]
        bag = tmp_path / "bag"
        with Writer(bag, version=9, storage_plugin=storage) as writer:
            connection = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=TYPES)
            for time, data in enumerate(raw):
                writer.write(connection, time, pack(data) if mode == "MESSAGE" else data)
        if mode == "FILE":
            (path,) = bag.glob("bag.*")
            path.write_bytes(pack(path.read_bytes()))
        described(bag, compression_mode=mode, compression_format=method)
        assert [data for _, _, data in content(bag)] == raw

    def test_chunks_that_overlap_are_read_in_the_order_of_recording(
        self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        """As long as what has to wait does not fill the memory."""
        times = [time for index in range(50) for time in (0 if index else 1, 10**9 + index)]
        messages = [Message(0, time, bytes(1000)) for time in times]
        path = file("mixed.mcap", mcap([("/a", "std_msgs/msg/String")], messages, Form(chunk=2)))(tmp_path)
        monkeypatch.setattr("geomid_ros.files.bags.mcap.MOST_BYTES", 400_000)
        assert [time for _, time, _ in content(path)] == sorted(times)
        monkeypatch.setattr("geomid_ros.files.bags.mcap.MOST_BYTES", 40_000)
        assert "overlap too much in time" in error_of(path)
