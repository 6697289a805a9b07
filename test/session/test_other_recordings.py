"""What an identified model's recordings say of links and effects together, as ``find_gap`` takes it up."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gap import planted

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.identifier import Identifier
from geomid_ros.files.models.posterior import write_posterior
from geomid_ros.gap.result import Finding
from geomid_ros.gap.workflow import find_gap
from geomid_ros.inference.prior import OtherRecordings
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.gap import identified_session, prior_information
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray

OFFSETS = np.array([0.3, -0.8, 0.5])  # [N m]
PAYLOAD, CENTRE = 0.6, np.array([0.05, 0.0, 0.05])  # [kg, m]
SMALL = {"size": 0.05, "posture": np.array([0.3, 0.6, -0.4]), "noise": 0.1}


def efforts(loaded: bool) -> planted.Efforts:
    """Of a robot whose effort sensors are off."""
    inertias = planted.true_inertias(71, 0.2)
    if loaded:
        x, y, z = CENTRE
        square = [y**2 + z**2, -x * y, x**2 + z**2, -x * z, -y * z, x**2 + y**2]
        inertias[-1] += PAYLOAD * np.array([1.0, x, y, z, *square])
        inertias[-1, [4, 6, 9]] += 1e-3
    rigid = planted.rigid(inertias)
    return lambda q, v, a: rigid(q, v, a) + OFFSETS


@pytest.fixture(scope="module")
def live() -> Session:
    urdf = (planted.BAGS / "arm3.urdf").read_text(encoding="utf-8")
    return Session(urdf, Configuration({"candidates": [], "effects": ["effort_offset"]}), "arm3.urdf")


@pytest.fixture(scope="module")
def estimate(live: Session) -> Estimate:
    """In a small motion weights and offsets are hardly told apart."""
    identifier = Identifier(live.model)
    identifier.add(planted.recording(efforts(loaded=False), 72, 40.0, **SMALL))
    return identifier.solve()


def test_with_the_prior_it_is_all_that_is_known(live: Session, estimate: Estimate) -> None:
    known, unsaid = prior_information(identified_session(live, estimate))
    assert known is not None
    posterior = estimate.posterior
    units = posterior.jacobian * posterior.prior_stds
    rows = known.rows @ units
    found = np.linalg.inv(rows.T @ rows + np.eye(len(units)))
    values, vectors = np.linalg.eigh(posterior.covariance / np.outer(posterior.prior_stds, posterior.prior_stds))
    expected = (vectors * np.minimum(values, 1.0)) @ vectors.T  # no data make anything less sure
    np.testing.assert_allclose(found, expected, atol=2e-3)
    assert np.min(np.diag(expected)[30:]) < 0.5, "of some effects something is known"
    assert np.max(np.abs(expected[:30, 30:])) > 0.1, "together with links"
    np.testing.assert_allclose(known.residuals, 0.0, atol=1e-5)
    np.testing.assert_allclose(unsaid[30:], np.diag(units)[30:], rtol=1e-9)


def test_it_is_read_from_the_file_beside_the_model_and_without_it_effects_are_known_by_themselves(
    live: Session, estimate: Estimate, tmp_path: Path
) -> None:
    own = identified_session(live, estimate)
    here, _ = prior_information(own)
    own.loaded = replace(own.loaded, posterior=None, source=str(tmp_path / "estimate.json"))
    alone, deviations = prior_information(own)
    assert here is not None
    assert alone is not None
    assert len(alone.changes) == 0
    np.testing.assert_array_equal(deviations, own.loaded.coefficient_stds(own.model))
    write_posterior(tmp_path / "posterior.npz", estimate.posterior)
    read, _ = prior_information(own)
    assert read is not None
    np.testing.assert_allclose(read.rows, here.rows, rtol=1e-9, atol=1e-9)
    own.loaded = replace(own.loaded, posterior=replace(estimate.posterior, links=("a", "b", "c")))
    of_others, _ = prior_information(own)
    assert of_others is not None
    assert len(of_others.changes) == 0, "a posterior of other links tells nothing"
    own.loaded = replace(own.loaded, posterior=None)
    other = replace(estimate.posterior, parameters=1.01 * estimate.posterior.parameters)
    write_posterior(tmp_path / "posterior.npz", other)
    with pytest.raises(InputError, match=r"posterior\.npz: belongs to another estimate than .*estimate\.json; keep"):
        prior_information(own)


def test_the_posterior_knows_of_the_bias_of_its_own_accelerometer(
    live: Session, estimate: Estimate, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That of the present one is another."""
    own, share = identified_session(live, estimate), 0.02
    exact, _ = prior_information(own)
    monkeypatch.setattr(Session, "relative_mass_std", share)
    found, _ = prior_information(own)
    assert exact is not None
    assert found is not None
    moved = np.zeros(exact.rows.shape[1])
    moved[: exact.links] = share * estimate.parameters[: exact.links] * np.resize([1.0] * 4 + [0.0] * 6, exact.links)
    before, after = (known.rows.T @ known.rows for known in (exact, found))
    lost = before @ moved
    np.testing.assert_allclose(after, before - np.outer(lost, lost) / (1.0 + moved @ lost), rtol=1e-6, atol=1e-6)


def test_a_payload_is_weighed_by_what_both_recordings_say_together(live: Session, estimate: Estimate) -> None:
    """An offset that was hardly known is the same one now; were it known by itself, it might be what has changed."""
    own = identified_session(live, estimate)
    train = [planted.recording(efforts(loaded=True), 73, 40.0, **SMALL)]
    held = [planted.recording(efforts(loaded=True), 1073, 15.0, **SMALL)]

    def sure(known: OtherRecordings | None, deviations: FloatArray) -> list[Finding]:
        given = {"nominal": own.prior, "deviations": deviations, "previous": known}
        return list(find_gap(own.model, train, held, **given).sure)

    (payload,) = sure(*prior_information(own))
    mass = payload.parameters["mass"]
    assert payload.effect == "payload"
    assert abs(mass.value - PAYLOAD) < 3.0 * mass.std
    assert mass.std < 0.1 * PAYLOAD
    assert payload.share > 0.9, "without it other recordings would be trusted less until the links explain it"
    own.loaded = replace(own.loaded, posterior=None, source="elsewhere/estimate.json")
    assert not sure(*prior_information(own))


def test_friction_of_all_joints_that_is_less_than_before_is_named_at_each() -> None:
    """As of a warm robot. Together the changes contradict what was known, each alone explains little of that."""
    urdf = (planted.BAGS / "arm3.urdf").read_text(encoding="utf-8")
    kinds, rigid = ("viscous_friction", "coulomb_friction"), planted.rigid(planted.true_inertias(71, 0.2))
    session = Session(urdf, Configuration({"candidates": [], "effects": [*kinds]}), "arm3.urdf")
    viscous, level = np.array([[1.5, 2.0, 0.9], [2.5, 3.0, 1.2]])

    def rubbing(warm: float) -> planted.Efforts:
        return lambda q, v, a: rigid(q, v, a) + warm * (viscous * v + level * np.tanh(v / 0.02))

    identifier = Identifier(session.model)
    identifier.add(planted.recording(rubbing(1.0), 72, 40.0))
    own = identified_session(session, identifier.solve())
    known, deviations = prior_information(own)
    train, held = [planted.recording(rubbing(0.7), 73, 30.0)], [planted.recording(rubbing(0.7), 74, 15.0)]
    found = find_gap(own.model, train, held, nominal=own.prior, deviations=deviations, previous=known)
    joints = own.model.robot.joint_names
    assert {(f.effect, f.joint) for f in found.sure} == {(kind, joint) for kind in kinds for joint in joints}
    for finding in found.sure:
        size = next(iter(finding.parameters.values()))
        true = 0.7 * (viscous if finding.effect == kinds[0] else level)[joints.index(finding.joint)]
        assert abs(size.value - true) < 3.0 * size.std
    assert np.all(found.gap.after < 0.2 * found.gap.before)
