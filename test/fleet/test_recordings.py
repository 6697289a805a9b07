"""Which bags a fleet has: folders, patterns, tables, other file systems."""

from __future__ import annotations

import os
from pathlib import Path

import fsspec
import pytest
from files.recordings import BAGS

from geomid_ros.errors import GeomidError, InputError
from geomid_ros.files.bags.bag import Bag
from geomid_ros.fleet.recordings import find_bags, on_this_disk

from .bags import piece


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two robots, one with a bag that is a single file."""
    folder = tmp_path_factory.mktemp("fleet")
    piece(folder / "left" / "monday", 0.0)
    piece(folder / "left" / "tuesday", 2.0)
    bag = piece(folder / "elsewhere", 4.0)
    (folder / "right").mkdir()
    bag.rename(folder / "right" / "monday")
    return folder


def found(source: str | Path, by: str = "robot") -> list[tuple[str, str]]:
    return [(bag.robot, bag.url.rpartition("/")[2]) for bag in find_bags(str(source), by)]


EVERY = [("left", "monday"), ("left", "tuesday"), ("right", "monday")]


def test_bags_behind_links(folder: Path, tmp_path: Path) -> None:
    """To a robot's folder and to a bag; circles and links to nowhere are no matter, and no bag counts twice."""
    (tmp_path / "left").symlink_to(folder / "left")
    (tmp_path / "right").mkdir()
    (tmp_path / "right" / "monday").symlink_to(folder / "right" / "monday")
    (tmp_path / "right" / "again").symlink_to(tmp_path)
    (tmp_path / "right" / "lost").symlink_to(tmp_path / "nowhere")
    assert found(tmp_path) == EVERY


def test_a_table_with_addresses_relative_to_it(folder: Path, tmp_path: Path) -> None:
    table = folder / "bags.csv"
    other = piece(tmp_path / "wednesday", 1.0)
    table.write_text(f"robot,serial,bag\na,1,left/monday\na,2,right/monday\nb,2,{other}\n")
    assert found(table) == [("a", "monday"), ("a", "monday"), ("b", "wednesday")]
    assert [robot for robot, _ in found(table, "serial")] == ["1", "2", "2"]
    with pytest.raises(InputError, match=r"unknown column 'plant'. Valid: bag, robot, serial"):
        find_bags(str(table), "plant")
    table.write_text("robot,bag\na,left/monday\nb,\n")
    with pytest.raises(InputError, match="line 3 has no bag or no robot"):
        find_bags(str(table))
    table.write_text("robot,bag\n../up,left/monday\n")
    with pytest.raises(InputError, match=r"the robot's name is '\.\./up', which is not a valid folder name"):
        find_bags(str(table))


def test_a_bag_that_changes_has_another_fingerprint(tmp_path: Path) -> None:
    bag = piece(tmp_path / "robot" / "bag", 0.0)
    (before,) = find_bags(str(tmp_path))
    assert find_bags(str(tmp_path)) == [before]
    (file,) = bag.glob("*.mcap")
    os.utime(file, ns=(0, 0))
    (touched,) = find_bags(str(tmp_path))
    file.write_bytes(file.read_bytes()[:-1])
    os.utime(file, ns=(0, 0))
    (shorter,) = find_bags(str(tmp_path))
    assert len({before.fingerprint, touched.fingerprint, shorter.fingerprint}) == 3


def test_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no rosbag found, expected ROBOT/BAG folders, a pattern or a \.csv file"):
        find_bags(str(tmp_path))
    with pytest.raises(InputError, match="cannot be reached"):
        find_bags("nonsense://bags")


def test_bags_in_an_object_store(folder: Path) -> None:
    memory = fsspec.filesystem("memory")
    memory.put(f"{folder}/left", "/fleet/left", recursive=True)
    bags = find_bags("memory://fleet")
    assert [(bag.robot, bag.url) for bag in bags] == [
        ("left", "memory:///fleet/left/monday"),
        ("left", "memory:///fleet/left/tuesday"),
    ]
    with on_this_disk(bags[0].url) as path:
        copied = path
        with Bag(path) as bag:
            assert bag.count(["/joint_states"]) > 100
    assert not copied.exists()
    with pytest.raises(GeomidError, match=r"no such bag|cannot be copied"), on_this_disk("memory:///fleet/absent"):
        pass
    with on_this_disk(str(BAGS / "arm3")) as path:
        assert path == BAGS / "arm3", "it stays where it is"
