"""A bag played into a node gives what the bag itself gives, and the topics say the same as the files."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from commands.running import WRIST, done, found_only, identify
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from files.recordings import BAGS
from geometry_msgs.msg import InertiaStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from visualization_msgs.msg import Marker, MarkerArray

from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.model.robot import Robot

from .observer import latched
from .stage import WRIST as WRIST_PARAMETERS
from .stage import description, messages, staged

ROBOT = "arm3"
SAME = 1e-6  # relative: what is identified live and from the bag
RATE = 1.0  # as a robot sends: the first estimate comes while there are data left to predict


TOPICS: dict[str, tuple[type, str]] = {
    "predicted": (JointState, "/geomid/predicted_joint_states"),
    "deviations": (JointState, "/geomid/predicted_efforts_std"),
    "streamed": (JointState, "/geomid/streamed_joint_states"),
    "diagnostics": (DiagnosticArray, "/diagnostics"),
}
KEPT: dict[str, tuple[type, str]] = {  # for those who come late
    "inertias": (InertiaStamped, "/geomid/inertias"),
    "descriptions": (String, "/geomid/robot_description"),
    "estimates": (String, "/geomid/estimate"),
    "markers": (MarkerArray, "/geomid/markers"),
}


class Live(SimpleNamespace):
    """A whole run: what was heard, ``saved``, also ``saved_at_end``, and identified ``offline``, from the bag."""

    @property
    def links(self) -> list[str]:
        return [link["name"] for link in self.saved["links"]]

    @property
    def stream(self) -> dict[str, str]:
        """The last diagnostics of the stream."""
        return {pair.key: pair.value for pair in self.diagnostics[-1].status[0].values}


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Live:
    """The shipped bag of a robot, played into a node that knows only the nominal URDF and the wrist's sensor."""
    folder = tmp_path_factory.mktemp("live")
    out = folder / "out"
    command = identify(ROBOT, *WRIST, "--hold-out", "0", "--json", "--out", folder / "offline")
    with pytest.MonkeyPatch.context() as patch:
        found_only(patch)
        run = Live(offline=json.loads(done(*command)))
    with staged(folder) as stage:
        parameters = {"robot_description": description(ROBOT), "output_folder": str(out), "solve_period": 2.0}
        node, observer = stage.node({**parameters, **WRIST_PARAMETERS}), stage.observer
        heard = {name: observer.collect(*topic) for name, topic in TOPICS.items()}
        heard |= {name: observer.collect(*topic, latched()) for name, topic in KEPT.items()}
        stage.spin_while(stage.play(BAGS / ROBOT, RATE, "--topic", "/wrench"))
        run.answer = observer.trigger("/geomid/save")
        run.saved, run.urdf = json.loads((out / "estimate.json").read_text()), read_urdf(out / "identified.urdf")
        late = {f"late_{name}": observer.collect(*topic, latched()) for name, topic in KEPT.items()}
        vars(run).update(heard, **late)
        count = len(messages(ROBOT)) // 2
        stage.fed({"joint_states": count, "/wrench": count})
        observer.wait_for(lambda: has_come(run), "what was saved, on all topics")
        observer.diagnostics(lambda _, status: status.message.startswith("no messages"), "silence")
        run.status, run.output = node.end(), node.output
        run.saved_at_end = json.loads((out / "estimate.json").read_text())
    return run


def masses_of(document: dict[str, Any]) -> list[float]:
    """Of the links in an estimate.json."""
    return [link["mass"] for link in document["links"]]


def has_come(run: Live) -> bool:
    """Whether the saved estimate has come on all topics: who comes late gets those before it first."""
    masses = masses_of(run.saved)
    inertias = (run.inertias, run.late_inertias)
    return (
        all([message.inertia.m for message in heard[-len(masses) :]] == masses for heard in inertias)
        and all(heard and heard[-1].data == run.urdf for heard in (run.descriptions, run.late_descriptions))
        and bool(run.late_markers)
        and all(
            heard and masses_of(json.loads(heard[-1].data)) == masses for heard in (run.estimates, run.late_estimates)
        )
    )


def test_every_message_is_received_and_accepted(live: Live) -> None:
    count = str(len(messages(ROBOT)) // 2)
    for topic in ("joint_states", "/wrench"):
        assert live.stream[f"{topic} received"] == live.stream[f"{topic} accepted"] == count
    assert not [key for key in live.stream if "rejected" in key or "dropped" in key]
    assert live.stream["queue"] == "0"
    assert "Dashboard" not in live.output, "without the parameter it has none"


def test_live_equals_the_bag(live: Live) -> None:
    assert live.answer[0], live.answer
    assert live.status == 0
    assert live.saved_at_end["links"] == live.saved["links"]
    assert live.saved["rows"] == live.offline["rows"]
    assert live.links == [link["name"] for link in live.offline["links"]]
    for ours, theirs in zip(live.saved["links"], live.offline["links"], strict=True):
        assert ours["mass"] == pytest.approx(theirs["mass"], rel=SAME)
        for key in ("com", "inertia"):
            difference = np.linalg.norm(np.subtract(ours[key], theirs[key]))
            assert difference < SAME * np.linalg.norm(theirs[key])
        assert ours["std"]["mass"] == pytest.approx(theirs["std"]["mass"], rel=1e-3)
    for our, their in zip(live.saved["effects"], live.offline["effects"], strict=True):
        assert (our["name"], our["joint"]) == (their["name"], their["joint"])
        assert our["value"] == pytest.approx(their["value"], rel=SAME)


def test_the_last_estimate_is_the_saved_one_with_its_description(live: Live) -> None:
    told = json.loads(live.estimates[-1].data)
    assert told.pop("robot_description") == live.descriptions[-1].data == live.urdf
    assert live.late_estimates[-1].data == live.estimates[-1].data
    differing = {key for key in told.keys() | live.saved.keys() if told.get(key) != live.saved.get(key)}
    assert differing <= {"messages", "warnings", "notes"}  # which go on
    bodies = {body.name: body for body in Robot(live.urdf, cuts=["wrist_ft"]).bodies}
    for link in live.saved["handover"]["urdf"]["links"]:
        assert bodies[link["name"]].parameters[0] == pytest.approx(link["mass"], rel=1e-8)


def of_message(message: InertiaStamped) -> dict[str, Any]:
    """A published inertia as estimate.json has it."""
    i = message.inertia
    return {
        "name": message.header.frame_id,
        "mass": i.m,
        "com": [i.com.x, i.com.y, i.com.z],
        "inertia": [[i.ixx, i.ixy, i.ixz], [i.ixy, i.iyy, i.iyz], [i.ixz, i.iyz, i.izz]],
    }


def test_the_last_inertias_are_the_saved_ones(live: Live) -> None:
    """One message per link, to the last digit: about the centre of mass, in the link's axes."""
    number = len(live.links)
    for heard in (live.inertias, live.late_inertias):
        last = [of_message(message) for message in heard[-number:]]
        assert last == [{key: link[key] for key in last[0]} for link in live.saved["links"]]
    assert len(live.inertias) % number == 0
    assert [message.header.frame_id for message in live.inertias[:number]] == live.links


def test_markers(live: Live) -> None:
    first, *markers = live.late_markers[-1].markers
    assert first.action == Marker.DELETEALL
    assert [marker.header.frame_id for marker in markers] == live.links
    assert len({(marker.ns, marker.id) for marker in markers}) == len(markers)
    for marker, link in zip(markers, live.saved["links"], strict=True):
        assert marker.type == Marker.SPHERE
        assert [marker.pose.position.x, marker.pose.position.y, marker.pose.position.z] == link["com"]
        q = marker.pose.orientation
        assert np.linalg.norm([q.x, q.y, q.z, q.w]) == pytest.approx(1.0, abs=1e-9)
        assert 0.0 < min(marker.scale.x, marker.scale.y, marker.scale.z) < 2.0
        assert all(0.0 <= part <= 1.0 for part in (marker.color.r, marker.color.g, marker.color.b, marker.color.a))


@pytest.mark.parametrize("topic", ["predicted", "streamed"])
def test_predicted_efforts_are_stamped_and_sized_as_the_data(topic: str, live: Live) -> None:
    predicted: list[JointState] = getattr(live, topic)
    measured = {
        item.message.header.stamp.sec * 10**9 + item.message.header.stamp.nanosec: item.message
        for item in messages(ROBOT)
        if item.topic == "/joint_states"
    }
    stamps = [message.header.stamp.sec * 10**9 + message.header.stamp.nanosec for message in predicted]
    assert len(stamps) > 10
    assert stamps == sorted(set(stamps))
    assert set(stamps) <= set(measured)
    joints = list(Robot(description(ROBOT)).joint_names)
    errors, efforts = [], []
    for stamp, message in zip(stamps, predicted, strict=True):
        assert list(message.name) == joints
        assert len(message.position) == len(message.velocity) == len(joints)
        effort = dict(zip(measured[stamp].name, measured[stamp].effort, strict=True))
        errors.append(np.array(message.effort) - [effort[joint] for joint in joints])
        efforts.append([effort[joint] for joint in joints])
    rms_error, rms_effort = (np.sqrt(np.mean(np.square(part), axis=0)) for part in (errors[-50:], efforts))
    assert np.all(rms_error < rms_effort)  # on a busy machine they are of an early estimate


def test_predicted_efforts_have_standard_deviations_of_the_same_instants(live: Live) -> None:
    expected = {(m.header.stamp.sec, m.header.stamp.nanosec): m for m in live.predicted}
    found = {(m.header.stamp.sec, m.header.stamp.nanosec): m for m in live.deviations}
    assert len(expected.keys() & found.keys()) > 10
    sizes = np.sqrt(np.mean([np.square(message.effort) for message in live.predicted], axis=0))
    for stamp in expected.keys() & found.keys():
        assert list(found[stamp].name) == list(expected[stamp].name)
        assert list(found[stamp].position) == list(expected[stamp].position)
        assert np.all(np.array(found[stamp].effort) > 0.0)
    last = np.sqrt(np.mean([np.square(message.effort) for message in live.deviations[-50:]], axis=0))
    assert np.all(last < sizes)  # on a busy machine they are of an early estimate


def test_diagnostics(live: Live) -> None:
    """One array about every second; one status per link, `node: link`, and one for the stream; a scalar per key. The
    bag has ended: nothing comes any more."""
    stamps = [array.header.stamp.sec + 1e-9 * array.header.stamp.nanosec for array in live.diagnostics]
    assert len(stamps) >= 2
    assert 0.5 < np.median(np.diff(stamps)) < 5.0  # a busy machine may be late, never early
    names = [status.name for status in live.diagnostics[-1].status]
    assert names == ["geomid: stream", *(f"geomid: {link}" for link in live.links)]
    for array in live.diagnostics:
        assert len({status.name for status in array.status}) == len(array.status)
        for status in array.status:
            assert status.message
            assert status.hardware_id
            assert len({pair.key for pair in status.values}) == len(status.values)
            assert status.level in (DiagnosticStatus.OK, DiagnosticStatus.WARN), status
    for status, link in zip(live.diagnostics[-1].status[1:], live.saved["links"], strict=True):
        values = {pair.key: pair.value for pair in status.values}
        assert float(values["mass"]) == pytest.approx(link["mass"], rel=1e-2)  # may be of just before the save
        assert float(values["from data"]) == pytest.approx(link["from_data"], abs=1e-2)
        for key, value in values.items():
            if key not in ("merged", "not identifiable"):
                float(value)
    assert live.stream["converged"] == "True"
    last = live.diagnostics[-1].status[0]
    assert (last.level, last.message) == (DiagnosticStatus.WARN, "no messages on /joint_states, /wrench")
