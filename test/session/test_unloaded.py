"""What was carried for a while is left out of recordings, and told; nothing else is."""

from __future__ import annotations

import re
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from files.recordings import BAGS, Recorded, made, stamped, write_bag
from monitoring.test_payload_watch import AFTER, BEFORE, MASS, RATE, Arm

import geomid_ros
from geomid_ros.errors import InputError
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.model.measurement_model import Rows
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.gap import GapReader, gap_session
from geomid_ros.session.recordings import Bags, read_bags
from geomid_ros.session.review import LeftOut
from geomid_ros.session.session import Session
from geomid_ros.session.unloaded import Unloaded

URDF = BAGS / "arm3.urdf"
NO_CHOICE = {"candidates": [""]}
BAG = Path("bag")
LATEST = 3.0  # [s] that may be left out before and after


@pytest.fixture
def session() -> Session:
    return Session(read_urdf(URDF), Configuration(NO_CHOICE), "arm3.urdf")


def times_of(parts: list[Samples]) -> list[float]:
    return [round(1e-9 * stamp, 3) for part in parts for stamp in part.stamps.tolist()]


def test_samples_with_a_payload_are_left_out_and_all_others_come_in_order(session: Session) -> None:
    arm = Arm()
    measured, unloaded = arm.measured(arm.loaded), Unloaded(session)
    kept = times_of([*unloaded(BAG, [measured.select(slice(0, 1234)), measured.select(slice(1234, None))])])
    left_out = sorted({round(1e-9 * stamp, 3) for stamp in measured.stamps.tolist()}.difference(kept))
    assert kept == sorted(set(kept))
    assert BEFORE - LATEST < left_out[0] < BEFORE < AFTER < left_out[-1] < AFTER + LATEST
    np.testing.assert_allclose(np.diff(left_out), 1.0 / RATE)
    (part,) = unloaded.left_out
    assert "bag: 'link3' carries 1.50 kg from 50.0 s on, until 65" in part.sentence
    assert [round(1e-9 * part.begin, 3), round(1e-9 * part.end, 3)] == [left_out[0], left_out[-1]]
    assert times_of([Bags(fitted=[BAG], left_out=[part]).kept(BAG, measured)]) == kept


def test_a_recording_without_a_payload_stays_whole_and_the_next_is_compared_with_it(session: Session) -> None:
    """What is still carried at its end is left out up to there."""
    arm = Arm()
    empty, loaded = arm.measured(arm.truth), arm.measured(arm.loaded)
    carrying = loaded.select(slice(round(BEFORE * RATE), round(AFTER * RATE)))
    unloaded = Unloaded(session)
    assert times_of([*unloaded(Path("first"), [empty])]) == times_of([empty])
    assert not unloaded.left_out
    assert not times_of([*unloaded(Path("second"), [carrying])])
    (part,) = unloaded.left_out
    assert (part.path, part.begin, part.end) == (Path("second"), carrying.stamps[0], carrying.stamps[-1] + 1)


@pytest.mark.parametrize("second", [1.3, 1.8])
def test_an_exchanged_payload_is_told_by_its_own_rows(session: Session, second: float) -> None:
    """Not by those since the exchange that came before it was noticed."""
    arm, unloaded = Arm(3), Unloaded(session)
    times_of([*unloaded(BAG, [arm.measured(arm.loaded, noise=0.1, then=arm.carrying(second))])])
    (part,) = unloaded.left_out
    masses = [float(mass) for mass in re.findall(r"([0-9.]+) kg", part.sentence)]
    assert masses == pytest.approx([MASS, second], rel=0.02)


def test_a_validation_bag_of_which_nothing_is_left_is_named(session: Session, tmp_path: Path) -> None:
    other = Path(shutil.copytree(BAGS / "arm3", tmp_path / "other"))
    all_of_it = LeftOut(other, 0, 2**62, "something is carried")
    bags = Bags(fitted=[BAGS / "arm3"], validate=[other], left_out=[all_of_it])
    with pytest.raises(InputError, match=f"^{re.escape(str(other))}: no data left to test on: something is carried$"):
        read_bags(session, bags, lambda _: None)


def test_what_is_left_out_is_left_out_of_its_own_bag_wherever_it_is_read() -> None:
    """From its first stamp to the last but one; simulations need what is left in one piece, and get the longest."""
    bag, other = BAGS / "arm3", Path("other")
    session = Session(read_urdf(URDF), Configuration(NO_CHOICE), "arm3.urdf")
    whole = GapReader(session, Bags(fitted=[bag])).samples(bag, session.new_pipeline())
    stamps = whole.stamps.tolist()
    last = len(stamps) - 40
    parts = [LeftOut(bag, stamps[begin], stamps[end], "") for begin, end in ((3, 6), (last, last + 10))]
    bags = Bags(fitted=[bag], left_out=[*parts, LeftOut(other, stamps[50], stamps[60], "")])
    reader = GapReader(session, bags)
    kept = [*stamps[:3], *stamps[6:last], *stamps[last + 10 :]]
    assert reader.samples(bag, session.new_pipeline()).stamps.tolist() == kept
    (longest,) = reader.high_cutoff_samples()
    assert longest.stamps[-1] < stamps[last] <= longest.stamps[-1] + 1e9 / RATE
    assert len(longest) > 100


def test_efforts_of_slow_joints_say_nothing_of_payloads(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    arm, judged = Arm(), list[Rows]()
    measured, unloaded = arm.measured(arm.truth), Unloaded(session)
    monkeypatch.setattr(unloaded._detector, "add", lambda first, stamps, rows: judged.append(rows))  # noqa: ARG005
    times_of([*unloaded(BAG, [measured])])
    targets, speed = np.concatenate([rows.targets for rows in judged]), np.abs(measured.velocity)
    assert np.all(np.isnan(targets[speed < 0.005]))
    assert np.mean(np.isfinite(targets[speed > 0.8 * np.max(speed)])) > 0.9


@pytest.fixture(scope="module")
def arm() -> Arm:
    return Arm()


@pytest.fixture(scope="module")
def bag(arm: Arm, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording in which the arm carries a payload from ``BEFORE`` to ``AFTER``."""
    return write_recording(tmp_path_factory.mktemp("recorded") / "bag", arm, arm.measured(arm.loaded))


def write_recording(path: Path, arm: Arm, measured: Samples) -> Path:
    kind, names = "sensor_msgs/msg/JointState", [*arm.robot.joint_names]
    messages = []
    for stamp, *numbers in zip(
        measured.stamps.tolist(), measured.position, measured.velocity, measured.effort, strict=True
    ):
        fields = dict(zip(("position", "velocity", "effort"), numbers, strict=True))
        message = made(kind, header=stamped(10**9 + stamp), name=names, **fields)
        messages.append(Recorded("/joint_states", kind, 10**9 + stamp, message))
    return write_bag(path, messages)


def check_left_out(notes: Sequence[str], *parts: Sequence[Samples]) -> None:
    """Nothing of when the payload was carried is left in the ``parts``, half of the rest is, and a note says so."""
    assert any("'link3' carries 1.5" in note and "left out" in note for note in notes)
    for part in parts:
        times = np.array(times_of(list(part))) - 1.0
        assert len(times) > 10.0 * RATE / 2.0
        assert not np.any((times > BEFORE) & (times < AFTER))


def test_identify_leaves_them_out_of_fit_and_test(arm: Arm, bag: Path) -> None:
    found = geomid_ros.identify(bag, URDF, config=NO_CHOICE, hold_out=0.3)
    assert "load" not in {finding.cause.kind for finding in found.session.review.findings}
    check_left_out(found.notes, found.train, found.held_out)
    last = found.links[-1]
    truth = float(arm.truth.links[-1][0])
    assert abs(last.mass - truth) < min(4.0 * last.std_mass, 0.5 * MASS)


def test_gap_leaves_them_out_of_search_and_test(bag: Path) -> None:
    session = gap_session(read_urdf(URDF), Configuration(NO_CHOICE), "arm3.urdf")
    read = GapReader(session, Bags(fitted=[bag])).read([])
    check_left_out(session.notes, read.train, read.held_out)


def test_gap_simulates_what_is_left_and_tells_what_is_not(bag: Path) -> None:
    """Else the payload is a gap: of a link, of loads, of gains; and a load that the recording's check doubts."""
    found = geomid_ros.find_gap(bag, URDF, hold_out=0.5)
    check_left_out(found.document["notes"], found.held_out)
    assert not found.session.review.findings
    (part,) = found.bags.left_out
    sharp = GapReader(found.session, found.bags).high_cutoff_samples()
    assert all(part.begin > samples.stamps[-1] or samples.stamps[0] >= part.end for samples in sharp)
    assert found.simulated


def test_a_gap_of_which_nothing_is_left_to_test_on_names_the_payload(arm: Arm, bag: Path, tmp_path: Path) -> None:
    measured = arm.measured(arm.loaded)
    carrying = measured.select(slice(round(BEFORE * RATE), round(AFTER * RATE)))
    other = write_recording(tmp_path / "other", arm, carrying)
    with pytest.raises(InputError, match=r"no held-out data: .*other: 'link3' carries 1\.5"):
        geomid_ros.find_gap(bag, URDF, validate=other)
