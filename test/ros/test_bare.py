"""A node without any library that only PyPI has finds what it finds with them."""

from __future__ import annotations

from pathlib import Path

import pytest

from .rig import rigged
from .test_catalogue_messages import MALFORMED


def test_it_finds_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As its twin, which reads messages with rosbags, also where some of the bytes are no messages."""
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1]))
    with rigged(tmp_path, "ros.bare", fresh=True) as rig:
        before, after = rig.begin()
        rig.feed(before)
        begin = len(rig.arrays)
        for data in MALFORMED.values():
            for topic, publisher in rig.publishers.items():
                publisher.publish(data)
                rig.sent[topic] += 1
        rig.feed(after)
        values = rig.settled(begin)
        for topic, kind in (
            ("joint_states", "sensor_msgs/msg/JointState"),
            ("/wrench", "geometry_msgs/msg/WrenchStamped"),
        ):
            refused = [key for key in values if key.startswith(f"{topic} rejected: not a valid {kind}")]
            assert sum(int(values[key]) for key in refused) == len(MALFORMED)
        rig.assert_same_as_twin()
