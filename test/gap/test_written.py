"""The written model is the one that was given, with what is sure to be otherwise."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from geomid_ros.estimation.identifier import Identifier
from geomid_ros.gap import confirmed_changes as written_module
from geomid_ros.gap import result as result_module
from geomid_ros.gap.records import Records
from geomid_ros.gap.result import GapResult, LinkChange
from geomid_ros.gap.workflow import find_gap
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.geometry.manifold import ONE_BODY
from geomid_ros.geometry.spd import Packed
from geomid_ros.inference.candidates import Candidate
from geomid_ros.inference.design import Design
from geomid_ros.inference.fit import JointFit
from geomid_ros.model.effects import DEFAULT_EFFECTS, EFFECTS, AtJoint, Quantity, effect_class
from geomid_ros.model.effects.effect import FRICTION_DRIFT
from geomid_ros.model.effects.friction import CoulombFriction, QuadraticFriction, StribeckFriction, ViscousFriction
from geomid_ros.model.effects.mounting import CarriedBody
from geomid_ros.model.effects.situation import OnLink
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.types import FloatArray

from . import planted
from .test_verdict import finding

BARE = planted.model()
JOINTS = BARE.robot.joint_names
MODEL = MeasurementModel(BARE.robot, (ViscousFriction(), CoulombFriction()))
GIVEN = planted.true_inertias(5, 0.1)
TRUE = planted.true_inertias(6, 0.02) - BARE.nominal_inertias.reshape(-1, 10) + GIVEN
"""The links differ from the model by as little as identified ones do, and nobody can say which."""
VISCOUS, MISSING, LEVEL = 0.3, 0.6, 0.4


def efforts(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
    viscous = np.array([1.02 * VISCOUS, MISSING, 0.0]) * v
    return planted.rigid(TRUE)(q, v, a) + viscous + np.array([0.0, 0.0, LEVEL]) * np.tanh(v / 0.02)


def known() -> FloatArray:
    """The model: inertias, viscous friction of the first joint, Coulomb friction of the last."""
    values = {("viscous_friction", JOINTS[0]): VISCOUS, ("coulomb_friction", JOINTS[2]): LEVEL}
    found = [values.get((c.effect.name, c.place_name), np.nan) for c in MODEL.coefficients]
    return np.append(GIVEN.ravel(), found)


def found(**options: Any) -> GapResult:
    train, unseen = planted.recording(efforts, 3), planted.recording(efforts, 1003, 15.0)
    return find_gap(MODEL, [train], [unseen], **options)


def test_what_no_finding_says_is_as_it_was_given() -> None:
    result = found(nominal=known())
    assert [(f.effect, f.joint) for f in result.sure] == [("viscous_friction", JOINTS[1])]
    assert not result.links
    np.testing.assert_array_equal(result.coefficients, known()[BARE.dimension :])
    np.testing.assert_array_equal(result.inertias, GIVEN)
    assert np.max(np.abs(TRUE - GIVEN)) > 0.01, "else nothing is to be put back"
    (named,) = result.sure
    size = named.parameters["coefficient"]
    assert abs(size.value - MISSING) < 3.0 * size.std
    assert f"{size.value:.4g}" in named.sentence


def test_a_link_that_leaves_its_prior_keeps_a_mass_that_no_effort_tells() -> None:
    """Eight times the inertia about the same centre: without a mass to hold, twice the mass predicts as well."""
    true = np.array([pseudo_inertia.from_parameters(body) for body in BARE.nominal_inertias.reshape(-1, 10)])
    true[1:, :3, :3] *= 8.0
    robot = planted.rigid(pseudo_inertia.to_parameters(true))
    train, unseen = planted.recording(robot, 7), planted.recording(robot, 1007, 15.0)
    free, held = (find_gap(BARE, [train], [unseen], masses_held=links) for links in ((), range(3)))
    off = [np.abs(np.log(found.inertias[:, 0] / true[:, 3, 3])) for found in (free, held)]
    assert np.max(off[0]) > 0.5
    assert np.max(off[1]) < 0.1
    np.testing.assert_allclose(held.gap.after, free.gap.after, atol=0.01)


def test_a_name_whose_written_size_may_be_nothing_is_none_and_not_written(monkeypatch: pytest.MonkeyPatch) -> None:
    def unsure(_: Design, fit: JointFit) -> JointFit:
        return replace(fit, packed=Packed.of(1e-6 * fit.information))

    monkeypatch.setattr(written_module, "scattered", unsure)
    result = found(nominal=known())
    assert result.findings == ()
    first = result.ranking[0]
    assert (first.effect, first.joint, first.chosen) == ("viscous_friction", JOINTS[1], False)
    assert result.verdict != "named"
    np.testing.assert_allclose(result.gap.after, result.gap.before, rtol=0.01)


@pytest.mark.parametrize(
    ("identified", "off", "is_sure"), [(True, 0.03, True), (False, 0.03, False), (True, 0.005, False)]
)
def test_a_payload_whose_written_mass_may_be_nothing_is_judged_by_its_moment(
    identified: bool, off: float, is_sure: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside an identified model; moments of a URDF's links are as uncertain. The search may have told a mass."""
    payload = Candidate.of(CarriedBody(), OnLink(2, 2))
    mass, moment = {"mass": Quantity(0.31, 0.18, "kg")}, {"m x": Quantity(off, 0.003, "kg m")}
    named = finding("payload", {"mass": Quantity(0.7, 0.15, "kg")}, joint=JOINTS[2], link="tool")
    analysis: Any = SimpleNamespace(
        usual_load=lambda _: 0.0, search=SimpleNamespace(prior=SimpleNamespace(identified=identified))
    )
    monkeypatch.setattr(written_module.library, "parameters", lambda *_, **__: mass)
    monkeypatch.setattr(written_module.library, "first_moment", lambda *_: moment)
    monkeypatch.setattr(written_module, "widened_by_remainder", lambda _, __, sizes, *___: sizes)
    fitted: Any = SimpleNamespace(chosen=[payload])
    (said,) = written_module._findings_as_written(BARE, analysis, fitted, fitted, fitted, [(payload, named)])
    assert (said.confidence == "confident") == is_sure
    assert said.moment == (moment if is_sure else {})
    assert said.parameters["mass"].value == 0.31


def test_a_moment_that_is_known_without_its_mass_stays_known() -> None:
    """Whatever the size of the payload in the fit that takes over what another one knows; nor is it known better."""
    covariance = 1e-8 * np.eye(10) + np.diag([0.2, *np.zeros(9)])

    def fitted(mass: float, height: float, information: float) -> JointFit:
        body = np.array([mass, 0.01, 0.02, mass * height, 0.1, 0.0, 0.1, 0.0, 0.0, 0.1])
        point = ONE_BODY.point(body)
        jacobian = ONE_BODY.jacobian(point)[0][0]
        packed = Packed.of(information * jacobian.T @ np.linalg.inv(covariance) @ jacobian)
        return JointFit(
            terms=(), point=point, manifold=ONE_BODY, score=0.0, squares=np.ones(1), packed=packed,
            weights=np.zeros(10), prior_stds=np.ones(1), inflation=1.0, separate_prior_stds=np.zeros(0),
            identified=True,
        )  # fmt: skip

    free = fitted(0.56, -0.03, 1.0)
    taken = written_module._as_uncertain(fitted(0.41, 0.09, 100.0), free)
    np.testing.assert_allclose(taken.covariance, covariance, rtol=1e-4, atol=1e-12)
    own = fitted(0.41, 0.09, 0.25)
    assert np.all(np.diag(written_module._as_uncertain(own, free).inverse) > 0.999 * np.diag(own.inverse))


def test_a_changed_link_is_said_as_it_is_written() -> None:
    """Its mass and its centre; as unsure as what was said before is off."""
    before, after = np.zeros((2, 10)), np.zeros((2, 10))
    after[1, :4] = 0.4, 0.04, -0.08, 0.12
    centre = {axis: Quantity(value, 0.01, "m") for axis, value in zip("xyz", (0.11, -0.25, 0.3), strict=True)}
    change = LinkChange("tool", "wrist", Quantity(0.5, 0.02, "kg"), 1.0, 50.0, 1.0, centre=centre)
    analysis = SimpleNamespace(search=SimpleNamespace(prior=SimpleNamespace(inertias=before, identified=True)))
    model, fitted = SimpleNamespace(body_names=["arm", "tool"]), SimpleNamespace(inertias=after)
    found: LinkChange = written_module._as_written(change, model, analysis, fitted, fitted)  # type: ignore[arg-type]
    assert (found.mass.value, found.mass.std) == pytest.approx((0.4, 0.1))
    assert [size.value for size in found.centre.values()] == pytest.approx([0.1, -0.2, 0.3])
    assert [size.std for size in found.centre.values()] == pytest.approx([0.01, 0.05, 0.01])
    assert found.sentence.endswith("centred at x 0.1 ± 0.01, y -0.2 ± 0.05, z 0.3 ± 0.01 m")


def test_a_link_beside_a_urdf_is_no_surer_than_beside_all_that_joints_may_have() -> None:
    """An offset of a vertical slide may be there in place of a mass, significant or not."""
    change, before, after = (
        LinkChange("arm", "slide", Quantity(0.8, 0.001, "kg"), 6.0, 50.0, 1.0),
        *np.zeros((2, 1, 10)),
    )
    after[0, 0] = 0.8
    analysis: Any = SimpleNamespace(search=SimpleNamespace(prior=SimpleNamespace(inertias=before, identified=False)))
    model: Any = SimpleNamespace(body_names=["arm"])
    fitted: Any = SimpleNamespace(inertias=after)
    for std, is_sure in ((0.01, True), (0.7, False)):
        full: Any = SimpleNamespace(body_covariance=lambda _, std=std: std**2 * np.eye(10))
        found = written_module._as_written(change, model, analysis, fitted, full)
        assert found.mass.std == pytest.approx(std)
        assert (found.confidence == "confident") == is_sure
        moved = replace(change, moment={"x": Quantity(0.1, 0.001, "kg m")})
        assert written_module._as_written(moved, model, analysis, fitted, full).moment["x"].std == pytest.approx(
            max(std, 0.1)
        )


def test_beside_a_urdf_joints_have_the_friction_that_every_joint_has(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whether it has a name or not."""
    monkeypatch.setattr(result_module, "SURE", 2.0)
    result = found()
    values = {(e.effect, e.joint): e.parameters for e in result.ordinary}
    assert result.sure == ()
    for key, true in {
        ("viscous_friction", JOINTS[0]): 1.02 * VISCOUS,
        ("viscous_friction", JOINTS[1]): MISSING,
        ("coulomb_friction", JOINTS[2]): LEVEL,
    }.items():
        size = next(iter(values[key].values()))
        within_motion = effect_class(key[0]).within_motion(size)
        assert abs(size.value - true) < 4.0 * within_motion
        assert within_motion < 0.1 * true
        assert size.std == pytest.approx(FRICTION_DRIFT * size.value, rel=0.1), "in another motion it is another"
    assert {effect for effect, _ in values} <= {"viscous_friction", "coulomb_friction"}, "nothing else is there"
    assert np.max(result.gap.after) < 1.2


def test_beside_a_urdf_the_written_model_has_what_identify_finds() -> None:
    """Also where it has no name; a size is that of the name alone."""
    quadratic = 0.07

    def thick(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        return planted.rigid(TRUE)(q, v, a) + np.array([1.0, 0.0, 0.0]) * v * (VISCOUS + quadratic * np.abs(v))

    recorded = [planted.recording(thick, 3)], [planted.recording(thick, 1003, 15.0)]
    given = {("quadratic_friction", AtJoint(0)): QuadraticFriction()}
    without, result = find_gap(BARE, *recorded), find_gap(BARE, *recorded, ordinary=given)
    assert [finding.effect for finding in result.sure] == ["viscous_friction"]
    assert result.findings == without.findings
    written = {(effect.effect, effect.joint): effect.parameters["coefficient"] for effect in result.ordinary}
    assert all(size.std > FRICTION_DRIFT * size.value for size in written.values())
    assert {key: size.value for key, size in written.items()} == {
        ("viscous_friction", JOINTS[0]): pytest.approx(VISCOUS, rel=0.02),
        ("quadratic_friction", JOINTS[0]): pytest.approx(quadratic, rel=0.2),
    }
    assert result.gap.after[0] < 1.1 < without.gap.after[0]


def test_the_written_model_is_fitted_to_reversals_too() -> None:
    """Where names are not judged: what creeping shows stands beside the sure Coulomb friction, whose size it leaves."""
    excess, slow = 0.4, StribeckFriction(0.034)

    def creeping(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        level = np.array([0.0, 0.0, 1.0]) * (LEVEL + excess * np.exp(-((v / slow.speed) ** 2)))
        return planted.rigid(TRUE)(q, v, a) + level * np.tanh(v / 0.02)

    given = {("stribeck_friction", AtJoint(2)): slow, ("coulomb_friction", AtJoint(2)): CoulombFriction()}
    result = find_gap(BARE, [planted.recording(creeping, 3)], [planted.recording(creeping, 1003, 15.0)], ordinary=given)
    assert [(finding.effect, finding.joint) for finding in result.sure] == [("coulomb_friction", JOINTS[2])]
    written = {effect.effect: effect.values for effect in result.ordinary if effect.joint == JOINTS[2]}
    assert len(written) == sum(effect.joint == JOINTS[2] for effect in result.ordinary), "each is written once"
    assert written["coulomb_friction"]["level"] == pytest.approx(LEVEL, rel=0.02)
    assert written["stribeck_friction"]["excess"] == pytest.approx(excess, rel=0.2)
    assert np.max(result.gap.after) < 1.2


def test_the_file_predicts_as_well_as_an_identified_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A file has no remainder: what it says is fitted without one, or friction would be left to that."""
    monkeypatch.setattr(result_module, "SURE", 2.0)

    def lacking(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        known = planted.rigid(GIVEN)(q, v, a) + VISCOUS * v + LEVEL * np.tanh(v / 0.02)
        return known + 0.5 * np.sin(9.0 * q + 1.0) + 0.3 * np.sin(3.0 * q[:, [1, 2, 0]])

    train, unseen = planted.recording(lacking, 3), planted.recording(lacking, 1003, 15.0)
    trace = find_gap(BARE, [train], [unseen]).trace
    identifier = Identifier(MeasurementModel(BARE.robot, [EFFECTS[name]() for name in DEFAULT_EFFECTS[:-1]]))  # type: ignore[misc]
    identifier.add(train)
    rows = identifier.model.rows(unseen)
    residual = rows.targets - rows.coefficients @ identifier.solve().parameters
    left, expected = (np.sqrt(np.mean(each**2, axis=0)) for each in (trace.measured - trace.after, residual))
    assert np.all(left < 1.1 * expected)


def test_friction_that_no_file_can_say_is_folded_into_what_files_say() -> None:
    """What is left of the friction is at right angles to what they can say."""
    quadratic = 0.4

    def thick(q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
        return planted.rigid(GIVEN)(q, v, a) + np.array([1.0, 0.0, 0.0]) * v * (VISCOUS + quadratic * np.abs(v))

    train, unseen = planted.recording(thick, 3), planted.recording(thick, 1003, 15.0)
    result = find_gap(MODEL, [train], [unseen])
    values = {(e.effect, e.joint): e.parameters["coefficient"].value for e in (*result.sure, *result.ordinary)}
    assert values["quadratic_friction", JOINTS[0]] == pytest.approx(quadratic, rel=0.05)
    v = train.select(Records.make([train], planted.CUTOFF).chosen[0]).velocity[:, 0]
    left = values["quadratic_friction", JOINTS[0]] * v * np.abs(v) - result.folded[JOINTS[0], "dynamics/damping"] * v
    assert abs(left @ v) < 1e-6 * np.linalg.norm(left) * np.linalg.norm(v)
    assert result.folded[JOINTS[0], "dynamics/damping"] > 0.3 * quadratic
