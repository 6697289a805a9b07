"""What was found goes into everything that begins with the model in which it was written.

One effect of those kinds that ``test_new_effect.py`` has not, in recordings as short as the workflow allows; ``python
-m benchmarks.round_trip`` does the same with all of them and longer ones.
"""

from __future__ import annotations

import pytest
from commands.running import done, undrawn
from files.recordings import QUICK

from benchmarks.round_trip import PLANTED, URDF, RoundTrip
from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.models.loaded_model import LoadedModel
from geomid_ros.options import silent
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.gap import find_in_messages, gap_session
from geomid_ros.session.recordings import Topics, read_samples
from geomid_ros.session.session import Session, save

SECONDS = 12.0
KINDS = {
    "that depends on the model": PLANTED["load_friction"],
    "a hinge behind the joint": PLANTED["joint_elasticity"],
    "a body": PLANTED["payload"],
}


@pytest.fixture(scope="module", params=KINDS)
def trip(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> RoundTrip:
    pytest.importorskip("mujoco")
    trip = RoundTrip(KINDS[request.param], tmp_path_factory.mktemp("trip"), SECONDS)
    with pytest.MonkeyPatch.context() as patch:  # a rotor as heavy as these needs no shorter steps than the links
        patch.setattr("geomid_ros.simulation.options._STIFF_STEP", QUICK)
        for motion in (1, 2):
            trip.bag(motion)
    return trip


def test_what_was_found_is_known_from_then_on(trip: RoundTrip) -> None:
    assert not list(trip.complaints())


def test_identification_shows_what_it_keeps(trip: RoundTrip, monkeypatch: pytest.MonkeyPatch) -> None:
    """An effect is at one place only; the configured ones are at all."""
    undrawn(monkeypatch)
    out = trip.folder / "shown"
    text = done("identify", trip.bag(2), "--urdf", URDF, "--model", trip.model("first"), "--out", out)
    known = LoadedModel.read(str(out / "estimate.json")).effects
    assert any(trip.planted.is_at(effect) for effect in known) != trip.planted.is_payload
    name = trip.planted.effect.replace("_", " ")
    assert (name in text.lower()) != trip.planted.is_payload


def test_the_node_goes_on_from_it(trip: RoundTrip) -> None:
    """As the node does: messages of another motion pass its session's pipeline, and are looked at for a gap."""
    configuration = Configuration({"model": str(trip.model("first"))})
    urdf = URDF.read_text(encoding="utf-8")
    session = Session(urdf, configuration, "robot_description")
    with Bag(trip.bag(2)) as bag:
        for samples in read_samples(bag, session, session.pipeline, Topics("joint_states", "odom")):
            session.identifier.add(samples)
    node, *_ = save(session, trip.folder / "node", session.identifier.solve())
    by_command, by_node = (LoadedModel.read(str(path)).effects for path in (trip.model("identified"), node))
    assert [(e.effect, e.joint) for e in by_node] == [(e.effect, e.joint) for e in by_command]
    for one, other in zip(by_command, by_node, strict=True):
        assert {n: q.value for n, q in one.parameters.items()} == pytest.approx(
            {n: q.value for n, q in other.parameters.items()}, rel=1e-6, abs=1e-9
        )
    result = find_in_messages(
        gap_session(urdf, configuration, "robot_description"), session.recent.entries(), None, silent
    )
    assert not result.findings
