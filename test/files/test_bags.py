"""Bags that cannot be read are refused with the file's name and what would help; the others are read as they are."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin

from geomid_ros.errors import InputError
from geomid_ros.files.bags.bag import Bag

from .recordings import BAGS, TYPES, altered, chunks, recorded, with_checksums, write_bag

zstd = pytest.importorskip("backports.zstd")
UR10 = Path(__file__).parents[3] / "shared/data/ur10_unisa_rosbag2"
FLIPS = 60  # per file


def read(path: Path) -> list[tuple[str, int, str]]:
    """Everything in a bag, as texts that can be compared."""
    with Bag(path) as bag:
        return [(topic, time, repr(message)) for topic, time, message in bag.messages(list(bag.topics))]


@pytest.fixture(scope="module")
def db3(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shipped bag of the small arm in the other format."""
    return write_bag(tmp_path_factory.mktemp("bags") / "arm3", recorded(BAGS / "arm3"), StoragePlugin.SQLITE3)


def test_formats_and_single_files_hold_the_same(db3: Path) -> None:
    everything = read(BAGS / "arm3")
    assert len(everything) == 1601
    assert [time for _, time, _ in everything] == sorted(time for _, time, _ in everything)
    for path in (BAGS / "arm3/arm3.mcap", db3, db3 / "arm3.db3"):
        assert sorted(read(path)) == sorted(everything)


def test_topics_and_counts() -> None:
    with Bag(BAGS / "arm3") as bag:
        assert bag.topics == {
            "/joint_states": "sensor_msgs/msg/JointState",
            "/robot_description": "std_msgs/msg/String",
            "/wrench": "geometry_msgs/msg/WrenchStamped",
        }
        assert bag.count(["/joint_states", "/wrench"]) == 1600
        assert bag.start == 1_700_000_000_000_000_000
        assert sum(1 for _ in bag.raw_messages(["/wrench"])) == 800
        assert list(bag.messages([])) == []
        for name in ("joint_states", "/joint_states"):
            assert bag.find_topic(name, "sensor_msgs/msg/JointState", "--joint-topic") == "/joint_states"


def test_a_missing_topic_is_answered_with_those_that_exist() -> None:
    with Bag(BAGS / "arm3") as bag, pytest.raises(InputError) as caught:
        bag.find_topic("joints", "sensor_msgs/msg/JointState", "--joint-topic")
    for part in ("arm3", "/joints", "--joint-topic", "/joint_states (sensor_msgs/msg/JointState)", "/wrench"):
        assert part in str(caught.value)


def test_a_topic_of_another_type_is_refused() -> None:
    with Bag(BAGS / "arm3") as bag, pytest.raises(InputError, match=r"/wrench is of type .*Wrench.*expected .*JointS"):
        bag.find_topic("wrench", "sensor_msgs/msg/JointState", "--joint-topic")


def empty_folder(folder: Path) -> Path:
    folder.mkdir()
    return folder


def without_storage(folder: Path) -> Path:
    shutil.copytree(BAGS / "arm3", folder)
    (folder / "arm3.mcap").unlink()
    return folder


def with_metadata(text: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        shutil.copytree(BAGS / "arm3", folder)
        (folder / "metadata.yaml").write_text(text)
        return folder

    return make


def file_of(name: str, data: bytes) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        folder.mkdir()
        (folder / name).write_bytes(data)
        return folder / name

    return make


MCAP = (BAGS / "arm3/arm3.mcap").read_bytes()
UNREADABLE: dict[str, tuple[Callable[[Path], Path], str]] = {
    "no such path": (lambda folder: folder, "no such bag"),
    "empty folder": (empty_folder, "without metadata.yaml.*name a bag's folder"),
    "storage missing": (without_storage, "arm3.mcap: cannot be read.*missing"),
    "metadata empty": (with_metadata(""), "cannot be read"),
    "metadata of something else": (with_metadata("a: 1"), "cannot be read.*rosbag2_bagfile_information"),
    "metadata is not YAML": (with_metadata("a: [1"), "cannot be read"),
    "metadata nested without end": (with_metadata("[" * 1100), "cannot be read"),
    "text": (file_of("notes.txt", b"not a bag"), "notes.txt: cannot be read.*wrong type"),
    "text called mcap": (file_of("notes.mcap", b"not a bag"), "cannot be read"),
    "text called db3": (file_of("notes.db3", b"not a bag" * 1000), "cannot be read"),
    "empty mcap": (file_of("empty.mcap", b""), "empty; it has no intact message"),
    "empty db3": (file_of("empty.db3", b""), "cannot be read"),
    "mcap's magic and no more": (file_of("start.mcap", MCAP[:8]), "cannot be read"),
}


@pytest.mark.parametrize("case", UNREADABLE)
def test_what_is_no_bag_is_refused(case: str, tmp_path: Path) -> None:
    make, message = UNREADABLE[case]
    path = make(tmp_path / "bag")
    with pytest.raises(InputError, match=message) as caught:
        read(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("storage", ["mcap", "db3"])
def test_a_flipped_bit_never_surprises(storage: str, tmp_path: Path) -> None:
    """Without checksums it may change a value; what it does not leave readable is refused by one kind of error."""
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    bag = write_bag(tmp_path / "bag", recorded(BAGS / "arm3")[:100], plugin)
    data = (bag / f"bag.{storage}").read_bytes()
    random_bits, refused = random.Random(1), 0
    for _ in range(FLIPS):
        damaged = bytearray(data)
        place = random_bits.choice([random_bits.randrange(len(data)), -1 - random_bits.randrange(3000)])
        damaged[place] ^= 1 << random_bits.randrange(8)
        path = tmp_path / f"flipped.{storage}"
        path.write_bytes(damaged)
        try:
            read(path)
        except InputError as error:
            assert str(path) in str(error)  # noqa: PT017 either outcome is right
            refused += 1
    assert refused > 0


def test_checksums_find_every_flipped_bit_in_a_chunk(tmp_path: Path) -> None:
    data = with_checksums(MCAP, zstd.decompress)
    assert data == MCAP, "the shipped bag has them"
    path = tmp_path / "sure.mcap"
    path.write_bytes(data)
    assert read(path) == read(BAGS / "arm3/arm3.mcap")
    random_bits = random.Random(2)
    for _, begin, end in chunks(data):
        damaged = bytearray(data)
        damaged[random_bits.randrange(begin, end)] ^= 1 << random_bits.randrange(8)
        path.write_bytes(damaged)
        with pytest.raises(InputError, match="damaged at byte"):
            read(path)


def test_a_message_that_is_not_of_its_type_is_named(tmp_path: Path) -> None:
    strings = [item for item in recorded(BAGS / "arm3") if item.topic == "/robot_description"]
    bag = write_bag(tmp_path / "bag", strings, StoragePlugin.SQLITE3)
    for path in (bag / "metadata.yaml", bag / "bag.db3"):
        # Types of the same length, so that the database stays whole.
        path.write_bytes(path.read_bytes().replace(b"std_msgs/msg/String", b"std_msgs/msg/Header"))
    with pytest.raises(InputError, match=r"message on /robot_description at \d+ ns is not a valid std_msgs/msg/Header"):
        read(bag)


def test_types_that_are_not_built_in_cost_only_their_topic(tmp_path: Path) -> None:
    """What a bag says of its own types is never looked at; other topics can be read."""
    bag = altered(BAGS / "arm3", tmp_path / "bag", lambda item: item)
    metadata = bag / "metadata.yaml"
    for path in (metadata, bag / "bag.mcap"):
        path.write_bytes(path.read_bytes().replace(b"std_msgs/msg/String", b"std_msgs/msg/Strink"))
    with Bag(bag) as opened:
        assert sum(1 for _ in opened.messages(["/wrench"])) == 800
        with pytest.raises(InputError, match="/robot_description"):
            list(opened.messages(["/robot_description"]))


def test_raw_messages_are_the_bytes_that_were_recorded() -> None:
    with Bag(BAGS / "arm3") as bag:
        raw_messages = list(bag.raw_messages(list(bag.topics)))
        kinds = bag.topics
    as_texts = [(topic, time, repr(TYPES.deserialize_cdr(raw, str(kinds[topic])))) for topic, time, raw in raw_messages]
    assert as_texts == read(BAGS / "arm3")


@pytest.mark.skipif(not UR10.is_dir(), reason="the measured data are not beside this repository")
def test_a_measured_db3_as_its_driver_recorded_it() -> None:
    with Bag(UR10 / "raw/ur10_exciting_trajectory.db3") as bag:
        topic = bag.find_topic("joint_states", "sensor_msgs/msg/JointState", "--joint-topic")
        messages = [message for _, _, message in bag.messages([topic])]
    assert len(messages) == 3441
