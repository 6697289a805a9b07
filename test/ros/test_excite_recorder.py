"""Recording what is heard: the bag is whole however it ends."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import Any

import pytest
from files.recordings import TYPES, recorded
from rosbags.rosbag2 import Writer

from geomid_ros.errors import GeomidError
from geomid_ros.files.bags.bag import Bag
from geomid_ros.ros.excite import Recorder

TEXT = "std_msgs/msg/String"
TOPICS = {"/said": TEXT, "/robot_description": TEXT}


def said(text: str) -> bytes:
    return bytes(TYPES.serialize_cdr(TYPES.types[TEXT](data=text), TEXT))


def test_everything_is_recorded_in_its_order_and_the_bag_is_whole_after_an_error(tmp_path: Path) -> None:
    texts = [f"{number} " * 200 for number in range(2000)]  # several chunks

    def interrupted() -> None:
        with Recorder(tmp_path / "bag", TOPICS) as recorder:
            for text in texts:
                recorder.write("/said", said(text))
            assert recorder.problem == ""
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    with Bag(tmp_path / "bag") as bag:
        assert bag.warnings == ()
        assert bag.has_checksums
    items = recorded(tmp_path / "bag")
    assert [item.message.data for item in items] == texts
    assert [item.time for item in items] == sorted(item.time for item in items)


def test_a_full_disk_is_told_and_does_not_hang(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with Recorder(tmp_path / "bag", TOPICS) as recorder:
        monkeypatch.setattr(Writer, "write", full)
        recorder.write("/said", said("one"))
        recorder.write("/said", said("two"))
    assert recorder.problem == f"{tmp_path / 'bag'}: cannot be written (No space left on device)"


def test_a_bag_that_is_there_is_not_written_over(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    with pytest.raises(GeomidError, match="bag: cannot be written"):
        Recorder(tmp_path / "bag", TOPICS)
