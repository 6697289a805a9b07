"""Faults in the messages of a recording: read from a bag and received by a node they get the same answer."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from files.recordings import BAGS, Recorded, recorded, write_bag
from ros.spoiling import later, stamp_of, stamped
from ros.waiting import PATIENCE, final_estimate
from signals.feeding import feed

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.live import worker as live
from geomid_ros.live.status import Failures, Listener
from geomid_ros.live.threads import Received
from geomid_ros.live.worker import Worker
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Bags, Training, read_bags
from geomid_ros.session.session import Session, document
from geomid_ros.signals.gates import CLOCK_SET, EARLY, SPIKE_OR_CONTACT
from geomid_ros.signals.joint_messages import UNWRAPPED
from geomid_ros.signals.sampler import IN_BURSTS
from geomid_ros.types import FloatArray, IntArray

pytestmark = pytest.mark.usefixtures("found_only")
MIDDLE = 400  # of 800 joint messages
NAN = float("nan")


@dataclass
class Joints:
    """The joint messages of the shipped arm, as arrays to be spoiled; ``kept`` are those that are sent. The clock of
    all topics is set by ``step`` [ns] in the middle; a ``phantom`` publishes, too."""

    stamps: IntArray
    arrays: dict[str, FloatArray]
    kept: Any
    phantom: bool = False
    step: int = 0

    @staticmethod
    def clean() -> Joints:
        states = [item.message for item in whole() if item.topic == "/joint_states"]
        stamps = np.array([stamp_of(item) for item in whole() if item.topic == "/joint_states"])
        order = np.argsort(states[0].name)
        arrays = {key: np.array([getattr(m, key)[order] for m in states]) for key in ("position", "velocity", "effort")}
        return Joints(stamps, arrays, np.ones(len(stamps), dtype=bool))

    @property
    def widest(self) -> int:
        """The joint that moves most."""
        return int(np.argmax(np.ptp(self.arrays["position"], axis=0)))

    def recorded(self) -> list[Recorded]:
        """All messages of the recording with these joint messages."""
        result, place = [], -1
        for item in whole():
            state = later(item, self.step * (place >= MIDDLE))
            if item.topic == "/joint_states":
                place += 1
                if not self.kept[place]:
                    continue
                fields = {key: values[place].copy() for key, values in self.arrays.items()}
                state = stamped(item.changed(name=sorted(item.message.name), **fields), int(self.stamps[place]))
                state = later(state, self.step * (place >= MIDDLE))
            result.append(state)
            if item.topic == "/joint_states" and self.phantom:
                result.append(later(state.changed(name=[f"left_{name}" for name in state.message.name]), 1_000_000))
        return result


@cache
def whole() -> list[Recorded]:
    return [item for item in recorded(BAGS / "arm3") if item.topic in ("/joint_states", "/wrench")]


def session() -> Session:
    configuration = Configuration({"candidates": []}).with_sensors([WrenchSensor.parse("/wrench:wrist_ft:mounted")])
    return Session(read_urdf(BAGS / "arm3.urdf"), configuration, "arm3.urdf")


def from_bag(messages: list[Recorded], folder: Path) -> tuple[Session, Estimate]:
    """As ``geomid identify`` reads it."""
    found = session()
    bag = write_bag(folder, messages)
    training = Training(found)
    read_bags(found, Bags(fitted=[bag], hold_out=0.0), training.add)
    training.end()
    return found, found.identifier.solve()


def from_node(messages: list[Recorded]) -> tuple[Session, Estimate, Any]:
    """As the node's threads take it, message by message; with the status that its diagnostics are made of."""
    found = session()
    with closing(Worker(found, 3600.0, Listener(), Failures())) as worker:
        for item in messages:
            worker.enqueue([Received(*item.raw, time.perf_counter())])
        estimate = final_estimate(worker)
        assert isinstance(estimate, Estimate), estimate
        status = worker.status(active=True)
    return found, estimate, status


def estimate_of(messages: list[Recorded]) -> Estimate:
    """That of messages which nobody judges as a whole."""
    found = session()
    found.identifier.add(feed(found.pipeline, (item.parsed for item in messages)))
    return found.identifier.solve()


@cache
def clean_estimate() -> Estimate:
    return estimate_of(whole())


@dataclass(frozen=True, kw_only=True)
class Case:
    """``spoil`` changes the joint messages, and returns those that are to be refused.

    ``refused``: a part of the reason; ``noted``: a part of a note; ``cause``: a part of what the recording seems to
    be; ``doubtful``: whether the result is; ``sigmas``: how far off the estimate of the clean recording may be
    [standard deviations]; None if it is to be that of the recording without the messages that are refused.
    """

    spoil: Callable[[Joints], IntArray]
    refused: str = ""
    noted: str = ""
    cause: str = ""
    doubtful: bool = False
    sigmas: float | None = None


NOTHING = np.zeros(0, dtype=np.int64)
CHOSEN = np.array([280, 422, 580, 689])
LATE = np.array([560, 622, 690, 752])  # once enough have come to tell which efforts are usual
TWO_OF_THREE = np.flatnonzero(np.arange(2 * MIDDLE) % 3)


def wraps(joints: Joints) -> IntArray:
    """In the middle of the joint's way."""
    position = joints.arrays["position"][:, joints.widest]
    middle = float(np.median(position))
    position[:] = np.remainder(position - middle, 2.0 * np.pi) + middle
    return NOTHING


def glitches(joints: Joints) -> IntArray:
    position = joints.arrays["position"][:, joints.widest]
    places = np.flatnonzero(np.abs(position) > 0.3)[100::50]
    position[places] = 0.0
    return places


def spikes(places: IntArray, step: int = 1) -> Callable[[Joints], IntArray]:
    """Of every ``step``-th message: 20 ms from the next one a spike and a contact cannot be told apart."""

    def spoil(joints: Joints) -> IntArray:
        joints.kept[np.arange(len(joints.kept)) % step > 0] = False
        joints.arrays["effort"][places, 1] -= 3.0 * np.ptp(joints.arrays["effort"][:, 1])
        return places

    return spoil


def early(joints: Joints) -> IntArray:
    joints.stamps[CHOSEN] += np.array([25, 55, 105, 405]) * 1_000_000
    return CHOSEN


def clock_set(step: int) -> Callable[[Joints], IntArray]:
    def spoil(joints: Joints) -> IntArray:
        joints.step = step
        return NOTHING

    return spoil


def in_bursts(size: int, apart: int) -> Callable[[Joints], IntArray]:
    """Stamped when they arrive, a burst at once."""

    def spoil(joints: Joints) -> IntArray:
        places = np.arange(len(joints.stamps))
        lasts = np.minimum(places // size * size + size - 1, len(places) - 1)
        joints.stamps[:] = joints.stamps[lasts] + apart * (places % size)
        return NOTHING

    return spoil


def another_sign(joints: Joints) -> IntArray:
    joints.arrays["effort"][MIDDLE:] *= -1.0
    return NOTHING


def two_publishers(joints: Joints) -> IntArray:
    joints.phantom = True
    return np.arange(len(joints.stamps))


def last_joint(field: str, value: Any, places: IntArray | None = None) -> Callable[[Joints], IntArray]:
    """Says this in so many messages, which are then to be refused, or throughout."""

    def spoil(joints: Joints) -> IntArray:
        joints.arrays[field][slice(None) if places is None else places, 2] = value
        return NOTHING if places is None else places

    return spoil


def renamed(joints: Joints) -> IntArray:
    """Two joints have each other's names."""
    for array in joints.arrays.values():
        array[:, [1, 2]] = array[:, [2, 1]]
    return NOTHING


STUCK = "the effort of 'joint3' never changes though the joint moves"
CASES = {
    "71-wraps": Case(spoil=wraps, noted=UNWRAPPED, sigmas=1e-3),
    "73-position-glitches": Case(spoil=glitches, refused="jumps, and back, faster than it can move"),
    "74-effort-spikes": Case(spoil=spikes(CHOSEN), refused="effort of 'joint2' is a spike"),
    "74-slow-effort-spikes": Case(spoil=spikes(LATE, 2), refused=f"effort of 'joint2' {SPIKE_OR_CONTACT}"),
    "75-stamps-ahead": Case(spoil=early, refused=EARLY),
    "76-clock-set-ahead": Case(spoil=clock_set(200_000_000), noted=CLOCK_SET, sigmas=1.0),
    "77-bursts": Case(spoil=in_bursts(20, 100_000), noted=IN_BURSTS, doubtful=True, sigmas=1.0),
    "78-an-effort-is-constant": Case(spoil=last_joint("effort", -3.7), cause=STUCK, doubtful=True, sigmas=np.inf),
    "82-names-exchanged": Case(
        spoil=renamed, cause="the names of joints 'joint2' and 'joint3' are swapped", doubtful=True, sigmas=np.inf
    ),
    "83-unit-in-mid-run": Case(spoil=another_sign, cause="the efforts of all joints have", doubtful=True),
    "85-mostly-nan": Case(
        spoil=last_joint("effort", NAN, TWO_OF_THREE), refused="effort of 'joint3' missing or not finite"
    ),
    "85-nan-throughout": Case(spoil=last_joint("effort", NAN), sigmas=np.inf),
    "85-two-publishers": Case(spoil=two_publishers, refused="the messages' names have the prefix 'left_'"),
    "87-five-per-batch": Case(spoil=in_bursts(5, 1000), noted=IN_BURSTS, doubtful=True, sigmas=1.0),
    "95-infinite-speeds": Case(
        spoil=last_joint("velocity", np.inf * np.array([1.0, -1.0, 1.0, -1.0]), CHOSEN),
        refused="velocity of 'joint3' not finite",
    ),
}


def numbers(estimate: Estimate) -> tuple[FloatArray, FloatArray]:
    """Masses and centres of mass, and their standard deviations."""
    values = [(link.mass, *link.com) for link in estimate.links]
    spread = [(link.std_mass, *link.std_com) for link in estimate.links]
    return np.array(values), np.array(spread)


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """The machine may be busy."""
    monkeypatch.setattr(live, "PATIENCE", PATIENCE)


@pytest.mark.parametrize("name", CASES)
def test_a_fault_gets_the_same_answer_in_a_bag_and_in_a_node(name: str, tmp_path: Path) -> None:
    case, joints = CASES[name], Joints.clean()
    refused = case.spoil(joints)
    messages = joints.recorded()
    found, estimate = from_bag(messages, tmp_path / "bag")
    theirs, their_estimate, status = from_node(messages)

    np.testing.assert_allclose(numbers(their_estimate)[0], numbers(estimate)[0], rtol=1e-7, atol=1e-9)
    account, their_account = (each.pipeline.ledger.topics["joint_states"] for each in (found, theirs))
    assert account == their_account
    assert account.received == (2 if joints.phantom else 1) * np.sum(joints.kept)
    assert found.pipeline.ledger.topics["/wrench"].rejected == {}

    assert all(case.refused in reason for reason in account.rejected)
    assert account.rejected.total() == len(refused)
    assert bool(case.refused) == bool(len(refused))
    assert any(case.noted in remark for remark in account.noted) or not case.noted

    written = document(found, estimate)
    assert written["messages"]["joint_states"]["rejected"] == dict(sorted(account.rejected.items()))
    assert (written["verdict"]["result"] == "doubtful") == case.doubtful
    said = [*written["verdict"]["reasons"], *written["warnings"]]
    for part in filter(None, (case.refused, case.cause, case.noted.removeprefix("driver error: "))):
        assert any(part in sentence for sentence in said), said
    if name == "85-nan-throughout":
        assert any("'joint3'" in sentence for sentence in said)

    assert_named_by_diagnostics(status, case)
    if case.sigmas is None and not case.doubtful:
        joints.kept[refused], joints.phantom = joints.phantom, False
        expected, _ = numbers(estimate_of(joints.recorded()))
        np.testing.assert_allclose(numbers(estimate)[0], expected, rtol=1e-9, atol=1e-12)
    elif case.sigmas is not None:
        expected, spread = numbers(clean_estimate())
        assert np.max(np.abs(numbers(estimate)[0] - expected) / spread) <= case.sigmas


def assert_named_by_diagnostics(status: Any, case: Case) -> None:
    """The next diagnostics say it, as an error if the result is doubtful, else as a warning."""
    pytest.importorskip("diagnostic_msgs")
    from geomid_ros.ros.diagnostics import Diagnostics  # noqa: PLC0415 needs ROS

    diagnostics = Diagnostics("geomid")
    diagnostics.array(status)
    for part in filter(None, (case.refused, case.noted, case.cause)):
        sentences = diagnostics.errors if case.doubtful else diagnostics.warnings
        assert any(part in sentence for sentence in sentences), (diagnostics.errors, diagnostics.warnings)
