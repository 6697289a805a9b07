"""Publishers of the node's results: estimates as ROS messages, and predicted efforts at the rate of the messages."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from operator import attrgetter

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import InertiaStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import ColorRGBA, Header, String
from visualization_msgs.msg import Marker, MarkerArray

from geomid_ros.checks.verdict import USABLE
from geomid_ros.estimation.estimate import Estimate, LinkEstimate, effort_deviations
from geomid_ros.exports.payload import Payload
from geomid_ros.files.schema import FORMAT, attributes_entry
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.live.effort_predictor import EffortPredictor, Predicted
from geomid_ros.live.searches import FoundGap, SearchStatus
from geomid_ros.live.status import Listener
from geomid_ros.live.threads import Received
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.model.se3 import quaternion
from geomid_ros.monitoring.change_detection import ChannelGap
from geomid_ros.monitoring.payload_watch import CarriedPayload
from geomid_ros.ros.inputs import Inputs
from geomid_ros.ros.startup import POLL
from geomid_ros.session.session import Session, document, identified_urdf
from geomid_ros.signals.messages import COMMANDS, JOINT_STATES
from geomid_ros.types import FloatArray

_LARGEST_MARKER = 2.0  # [m] an unidentifiable link may have any size, which RViz need not show


def latched(depth: int = 1) -> QoSProfile:
    """Return a QoS profile that keeps the last messages for late subscribers."""
    return QoSProfile(depth=depth, durability=DurabilityPolicy.TRANSIENT_LOCAL, reliability=ReliabilityPolicy.RELIABLE)


class Outputs(Listener):
    """Publishes inertias, predicted efforts, the identified URDF, markers and findings, from any thread."""

    def __init__(self, node: Node, create: Callable[..., Publisher], streaming: Streaming) -> None:
        """
        Args:
            node: publishes its results.
            create: its method that makes publishers.
            streaming: predicts joint states with each new estimate, and commands with usable ones.
        """
        self._node = node
        self._streaming = streaming
        self._lock = threading.Lock()  # held while expensive results are computed
        self._last: tuple[Session, Estimate] | None = None
        self._described: Estimate | None = None  # published as a robot description
        self._judged: Estimate | None = None  # published as a whole, with its verdict
        self._inertias = create(InertiaStamped, "~/inertias", latched(256))
        self._links: list[str] = []  # of the last estimate
        self._predictions = create(JointState, "~/predicted_joint_states", 1000)
        self._deviations = create(JointState, "~/predicted_efforts_std", 1000)
        self._identified = create(String, "~/robot_description", latched())
        self._estimates = create(String, "~/estimate", latched())
        self._ellipsoids = create(MarkerArray, "~/markers", latched())
        self._findings = create(String, "~/gap", latched())
        self._gaps = create(String, "~/gap/open", latched())
        self._carried = create(InertiaStamped, "~/payload/inertia", latched())
        self._link = ""  # that carried the last payload
        self._payloads = create(String, "~/payload", latched())

    def on_samples(self, session: Session, samples: Samples, estimate: Estimate) -> None:
        """Publish the efforts that an estimate predicts for samples, and their std, if there are subscribers."""
        if self._predictions.get_subscription_count() > 0:
            efforts = session.model.predicted_efforts(samples, *estimate.predictor)
            _publish_efforts(self._predictions, session.robot, samples, efforts)
        if self._deviations.get_subscription_count() > 0:
            deviations = effort_deviations(session.model, samples, estimate)
            _publish_efforts(self._deviations, session.robot, samples, deviations)

    def on_estimate(self, session: Session, estimate: Estimate) -> None:
        """Publish an estimate, and predict with it."""
        self._streaming.predictors[JOINT_STATES].set_model(session, estimate)
        self.publish_estimate(session, estimate)

    def publish_estimate(self, session: Session, estimate: Estimate) -> None:
        """Publish an estimate; all zeros as inertias of links that only the one before had."""
        stamp = self._node.get_clock().now().nanoseconds
        before, self._links = self._links, [link.name for link in estimate.links]
        for name in before:
            if name not in self._links:
                self._inertias.publish(InertiaStamped(header=Header(frame_id=name, stamp=ros_time(stamp))))
        for link in estimate.links:
            self._inertias.publish(inertia_message(link.name, link.parameters, stamp))
        markers = [_marker(index, link, stamp) for index, link in enumerate(estimate.links)]
        self._ellipsoids.publish(MarkerArray(markers=[Marker(action=Marker.DELETEALL), *markers]))
        self._last, self._described, self._judged = (session, estimate), None, None
        self.publish_wanted()

    def publish_wanted(self) -> None:
        """Publish those results of the last estimate that are expensive, if there are subscribers that have not
        received them, and feed commands forward with it if it is usable."""
        with self._lock:
            if self._last is None or not self._node.context.ok():
                return
            session, estimate = self._last
            if self._described is not estimate and self._identified.get_subscription_count():
                self._described = estimate
                self._identified.publish(String(data=identified_urdf(session, estimate)))
            wanted = self._estimates.get_subscription_count() or self._streaming.is_wanted(COMMANDS)
            if self._judged is not estimate and wanted:
                self._judged = estimate
                whole = document(session, estimate) | {"robot_description": identified_urdf(session, estimate)}
                self._estimates.publish(String(data=json.dumps(whole)))
                if whole["verdict"]["result"] == USABLE:
                    self._streaming.predictors[COMMANDS].set_model(session, estimate)

    def forget(self) -> None:
        """Publish and predict nothing more of the last estimate."""
        self._last = None
        self._streaming.forget()

    def publish_gap(self, status: SearchStatus[FoundGap]) -> None:
        """Publish the result of a search for a gap."""
        self._findings.publish(String(data=json.dumps({"format": FORMAT, **status.document}, indent=2)))
        self._node.get_logger().info(status.sentence)

    def on_gaps(self, gaps: Sequence[ChannelGap]) -> None:
        """Publish the channels in which a gap is open."""
        entries = [attributes_entry(gap, "channel", "times_floor", "since") for gap in gaps]
        self._gaps.publish(String(data=json.dumps({"format": FORMAT, "gaps": entries})))

    def on_payload(self, carried: CarriedPayload | None) -> None:
        """Publish the payload that was picked up, and predict with it; all zeros after it was put down."""
        for predictor in self._streaming.predictors.values():
            predictor.set_payload(carried)
        self._link = carried.link if carried is not None else self._link
        stamp = self._node.get_clock().now().nanoseconds
        message = InertiaStamped() if carried is None else inertia_message(carried.link, carried.parameters, stamp)
        message.header.frame_id, message.header.stamp = self._link, ros_time(stamp)
        self._carried.publish(message)

    def publish_identified_payload(self, status: SearchStatus[Payload]) -> None:
        """Publish a payload that was identified, or the reason why it was not."""
        self._payloads.publish(String(data=json.dumps(status.document, indent=2)))
        self._node.get_logger().info(status.sentence)


def ros_time(nanoseconds: int) -> Time:
    """Return a stamp from nanoseconds since the epoch."""
    return Time(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)


def inertia_message(link: str, parameters: FloatArray, stamp: int) -> InertiaStamped:
    """Inertia ``(10,)`` as a message: frame_id is the link, com in its frame, inertia about the com in its axes."""
    message = InertiaStamped()
    message.header.frame_id = link
    message.header.stamp = ros_time(stamp)
    inertia = message.inertia
    mass, x, y, z, *entries = map(float, pseudo_inertia.quantities_of(parameters))
    inertia.m, inertia.com.x, inertia.com.y, inertia.com.z = mass, x, y, z
    for name, value in zip(pseudo_inertia.INERTIA_NAMES, entries, strict=True):
        setattr(inertia, name, value)
    return message


def _publish_efforts(publisher: Publisher, robot: Robot, samples: Samples, efforts: FloatArray) -> None:
    """Publish the filtered motion of samples with these ``efforts (N, joints)``, stamped as the data."""
    numbers = (samples.stamps, samples.position, samples.velocity, efforts)
    for stamp, position, velocity, effort in zip(*(array.tolist() for array in numbers), strict=True):
        message = JointState(name=robot.joint_names, position=position, velocity=velocity, effort=effort)
        message.header.stamp = ros_time(stamp)
        publisher.publish(message)


def _marker(index: int, link: LinkEstimate, stamp: int) -> Marker:
    """Return a link's equivalent ellipsoid in its frame, from blue (from the prior) to orange (from the data)."""
    semi_axes, axes = pseudo_inertia.equivalent_ellipsoid(link.parameters)
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])  # eigenvectors may be left-handed
    marker = Marker(ns="identified", id=index, type=Marker.SPHERE, action=Marker.ADD, frame_locked=True)
    marker.header.frame_id = link.name
    marker.header.stamp = ros_time(stamp)
    pose = marker.pose
    pose.position.x, pose.position.y, pose.position.z = map(float, link.com)
    pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w = map(float, quaternion(axes))
    size = np.minimum(2.0 * semi_axes, _LARGEST_MARKER)
    marker.scale.x, marker.scale.y, marker.scale.z = map(float, size)
    fraction = link.from_data
    marker.color = ColorRGBA(r=0.2 + 0.7 * fraction, g=0.45, b=0.9 - 0.7 * fraction, a=0.5)
    return marker


class _Stream:
    """Publishes predictions for the messages of a ``topic`` while it has subscribers."""

    def __init__(self, node: Node, topic: str, predictor: EffortPredictor, warn: Callable[[str], None]) -> None:
        self.topic, self.predictor, self._warn = topic, predictor, warn
        self._context = node.context  # without ROS there are no subscribers
        self._publisher = node.create_publisher(JointState, f"~/streamed_{topic}", 1000)
        self._warned: set[str] = set()

    def forget(self) -> None:
        self.predictor.forget()
        self._warned.clear()

    @property
    def has_subscribers(self) -> bool:
        return self._context.ok() and bool(self._publisher.get_subscription_count())

    @property
    def active(self) -> bool:
        """True if there is a subscriber, and an estimate to predict with."""
        return self.predictor.ready and self.has_subscribers

    def publish(self, messages: Sequence[bytes]) -> None:
        """Predict messages (CDR). An error is raised, and stops predictions until the next estimate."""
        handle = self._publisher.handle
        try:
            for predicted in self.predictor.predict(messages):
                with handle:
                    for data in serialised(predicted):
                        handle.publish_raw(data)
        except Exception:
            self.forget()
            raise
        for reason in tuple(self.predictor.refused):
            self.say(reason)

    def say(self, reason: str) -> None:
        """Warn once why messages are not streamed."""
        if reason and reason not in self._warned:
            self._warned.add(reason)
            self._warn(f"{self._publisher.topic_name} lacks messages: {reason}")


class Streaming:
    """Publishes ``~/streamed_joint_states`` and ``~/streamed_joint_commands`` while they have subscribers, and keeps
    the messages for the worker."""

    def __init__(
        self, node: Node, inputs: Inputs, predictors: Mapping[str, EffortPredictor], warn: Callable[[str], None]
    ) -> None:
        """
        Args:
            node: publishes.
            inputs: where messages wait.
            predictors: predict the messages of each topic.
            warn: receives the reason why messages are not streamed.
        """
        self._inputs, self.predictors = inputs, predictors
        self._streams = [_Stream(node, topic, predictor, warn) for topic, predictor in predictors.items()]
        self._early: list[Received] = []

    def forget(self) -> None:
        """Predict nothing until the next estimate."""
        for stream in self._streams:
            stream.forget()

    def drain(self) -> list[Received]:
        """Return all messages that identification uses and that were not taken yet."""
        self._take()
        messages, self._early = self._early, []
        unused = COMMANDS if self._inputs.only_streams_commands else ""
        return sorted((message for message in messages if message.topic != unused), key=attrgetter("time"))

    def is_wanted(self, topic: str) -> bool:
        """True if somebody subscribes to the stream of a topic's messages."""
        return any(stream.topic == topic and stream.has_subscribers for stream in self._streams)

    @property
    def active(self) -> bool:
        """True if a stream has a subscriber, and an estimate to predict with."""
        return any(stream.active for stream in self._streams)

    def wait(self, seconds: float) -> None:
        """Wait, and predict messages meanwhile. An error is raised, and stops predictions until the next estimate."""
        end = time.monotonic() + seconds
        for stream in self._streams:
            if stream.has_subscribers:
                stream.say(stream.predictor.obstacle)
            if stream.topic == COMMANDS:
                self._inputs.stream_commands(stream.active)
        while self.active and time.monotonic() < end:
            time.sleep(POLL)
            for stream in self._streams:
                if stream.active:
                    self._take(stream.topic)
        time.sleep(max(0.0, end - time.monotonic()))

    def _take(self, topic: str | None = None) -> None:
        """Take the messages that wait, of all topics or of one, and predict them."""
        messages = self._inputs.poll(topic)
        self._early += messages
        for stream in self._streams:
            if stream.active:
                stream.publish([message.data for message in messages if message.topic == stream.topic])


@cache
def _template(joints: tuple[str, ...]) -> tuple[bytes, np.dtype[np.void]]:
    """Return a message of these joints with zeros as numbers, and its layout."""
    zeros = [0.0] * len(joints)
    data = serialize_message(JointState(name=joints, position=zeros, velocity=zeros, effort=zeros))
    numbers, count = ("<f8", (len(joints),)), "V8"  # an array's length precedes it, and is aligned
    begin = f"V{len(data) - 12 - 3 * 8 * len(joints) - 2 * 8}"  # header and names
    stamp = [("", "V4"), ("seconds", "<u4"), ("nanoseconds", "<u4"), ("", begin)]
    return data, np.dtype(
        [*stamp, ("position", numbers), ("", count), ("velocity", numbers), ("", count), ("effort", numbers)]
    )


def serialised(predicted: Predicted) -> Iterator[bytes]:
    """Yield the messages (CDR). Making and serialising them one by one takes several times as long."""
    data, form = _template(predicted.joints)
    messages = np.frombuffer(bytearray(data * len(predicted.stamps)), form)
    messages["seconds"], messages["nanoseconds"] = np.divmod(predicted.stamps, 10**9)
    messages["position"], messages["velocity"] = predicted.motion[:2]
    messages["effort"] = predicted.efforts
    return (message.tobytes() for message in messages)
