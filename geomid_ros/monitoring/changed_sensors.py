"""Whether it is a wrench sensor that has changed, rather than the robot."""

from __future__ import annotations

from collections.abc import Sequence

from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.monitoring.change_detection import BLOCK, ChannelGap


def sensor_channels(model: MeasurementModel) -> dict[str, list[int]]:
    """The places of each mounted sensor's channels, by its topic."""
    places = {channel.name: place for place, channel in enumerate(model.channels)}
    return {s.topic: [places[f"{s.topic.strip('/')}/{axis}"] for axis in s.axes] for s in model.mounted}


def changed_sensors(gaps: Sequence[ChannelGap], model: MeasurementModel) -> dict[str, int] | None:
    """The mounted sensors that have changed, and the number of the instant before which they had not, by topic; None if
    it may be the robot that has.

    A load that is picked up is felt by other sensors and at the joints, too: where there is a gap at any other channel,
    or no other is watched, it may be the robot.
    """
    mounted = {topic: [model.channels[p].name for p in places] for topic, places in sensor_channels(model).items()}
    others = {gap.channel for gap in gaps}.difference(*mounted.values())
    first = {gap.channel: gap.first for gap in gaps if gap.since is not None}
    # A change in the last rows of a block does not show there.
    begin = {
        topic: min(first[name] for name in names if name in first) - BLOCK
        for topic, names in mounted.items()
        if not first.keys().isdisjoint(names)
    }
    may_be_the_robot = not others or not others.isdisjoint(first) or len(begin) > 1
    return None if may_be_the_robot else begin
