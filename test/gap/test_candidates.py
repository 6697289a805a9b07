"""What may be named: places, coefficients, parameters, and what excludes what."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from model.robots import urdf

from geomid_ros.errors import InputError
from geomid_ros.gap import candidates as library
from geomid_ros.inference.candidates import Candidate, EffectTerm
from geomid_ros.model.effects import (
    DEFAULT_EFFECTS,
    EFFECTS,
    AtJoint,
    OnLink,
    OnRobot,
    SituationEffect,
    effect_class,
)
from geomid_ros.model.effects.drive import CROSSINGS
from geomid_ros.model.effects.friction import DISTANCES, SETTING_IN, SMOOTHINGS, SPEEDS
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.moving_base import Contact
from geomid_ros.model.robot import Robot
from geomid_ros.session.gap import find_gap_in_samples

from . import planted

MODEL = planted.model()
ALL = library.candidates(MODEL)
VARIANTS = {
    "coulomb_friction": len(SMOOTHINGS),
    "saturating_friction": len(SETTING_IN) - 2,
    "presliding": len(DISTANCES),
    "stribeck_friction": len(SPEEDS),
    "backlash": len(CROSSINGS),
}


def named(effect: str, joint: int | None = None) -> list[Candidate]:
    return [c for c in ALL if c.name == effect and (joint is None or c.joint == joint)]


@pytest.mark.parametrize("name", [name for name, cls in EFFECTS.items() if cls.place == "joint" and cls.has_columns])
def test_an_effect_of_joints_is_possible_at_every_joint_with_all_its_constants(name: str) -> None:
    for joint in range(3):
        own = named(name, joint)
        assert len(own) == VARIANTS.get(name, 1)
        assert len({candidate.effect for candidate in own}) == len(own)
        assert {candidate.place for candidate in own} == {AtJoint(joint)}
        assert {candidate.odds for candidate in own} == {1.0 if name in DEFAULT_EFFECTS else 0.01}
        shares = [np.exp(-0.5 * candidate.cost) / candidate.odds for candidate in own]
        np.testing.assert_allclose(shares, 1.0 / len(own))
        assert {candidate.group for candidate in own} == {(name, AtJoint(joint))}


def test_others_are_possible_at_the_robot_and_at_every_link() -> None:
    assert [(c.place, c.joint, c.payload) for c in named("gravity_tilt")] == [(OnRobot(), None, None)]
    assert [(c.place, c.joint, c.payload) for c in named("payload")] == [
        (OnLink(link, link), link, link) for link in range(3)
    ]
    assert [len(candidate.terms) for candidate in named("payload")] == [0, 0, 0]
    assert not named("wrench_offset"), "there is no sensor"


def test_what_the_model_has_may_have_changed_with_the_constants_and_signs_that_it_has() -> None:
    """At a speed that is none of those to choose from."""
    at = AtJoint(1)
    stribeck = EFFECTS["stribeck_friction"](0.0333)
    level, excess = (EffectTerm(part, at) for part in stribeck.parts)
    known = library.candidates(MODEL, [level, excess])
    dry = [c for c in known if c.joint == 1 and c.name in ("coulomb_friction", "stribeck_friction")]
    assert {(c.effect, c.terms, c.positives) for c in dry} == {
        (level.effect, (level,), 1),
        (stribeck, (level, excess), 2),
    }
    assert {c.positives for c in named("stribeck_friction", 1)} == {2}
    assert [c.group for c in known if c not in dry] == [c.group for c in ALL if c.group not in {d.group for d in dry}]


def test_half_of_a_name_is_no_name() -> None:
    """A model that has the excess of a Stribeck friction alone has none that could have changed."""
    level, excess = named("stribeck_friction", 1)[0].terms
    assert [c.name for c in library.candidates(MODEL, [excess]) if c.in_model] == []
    assert [c.name for c in library.candidates(MODEL, [level]) if c.in_model] == ["coulomb_friction"]


def one(name: str, joint: int | None = None) -> Candidate:
    return named(name, joint)[0]


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        (named("coulomb_friction", 0)[0], named("coulomb_friction", 0)[2], True),
        (one("coulomb_friction", 0), one("coulomb_friction", 1), False),
        (one("coulomb_friction", 0), one("stribeck_friction", 0), True),
        (one("coulomb_friction", 0), one("stribeck_friction", 1), False),
        (one("spring", 2), one("effort_offset", 2), True),
        (one("spring", 2), one("viscous_friction", 2), False),
        (named("payload")[0], named("payload")[2], True),
        (named("payload")[0], one("spring", 0), False),
    ],
)
def test_what_makes_no_sense_together_excludes_each_other(first: Candidate, second: Candidate, expected: bool) -> None:
    assert first.excludes(second) == expected
    assert second.excludes(first) == expected


def test_on_legs_no_name_depends_on_loads_but_friction() -> None:
    """The ground loads the joints of a leg that stands, too; how that load changes is not known there. Such an effect
    of a model is no candidate either."""
    robot = Robot(urdf("go2.urdf"), floating_base=True)
    model = MeasurementModel(robot, [], contacts=[Contact("FL_foot", 0.02)])
    known = [EffectTerm(effect_class(name)(), AtJoint(0)) for name in ("effort_gain", "viscous_friction")]
    found = library.candidates(model, known)
    assert {c.name for c in found if isinstance(c.effect, SituationEffect)} == {"load_friction"}
    assert {"viscous_friction", "payload"} <= {c.name for c in found}


def test_a_model_with_effects_of_loads_is_refused_on_legs() -> None:
    """By the name of the effect, before anything is fitted."""
    loaded = SimpleNamespace(situational_effects=[1], not_predicted="m.json: effort_gain of elbow: not predicted")
    session: Any = SimpleNamespace(model=SimpleNamespace(legs=True), loaded=loaded)
    unused: Any = None
    with pytest.raises(InputError, match=r"effort_gain of elbow.*leave them out of the model"):
        find_gap_in_samples(session, unused, unused, unused, unused)
