"""Sizes are as unsure as what else may be true leaves them."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from geomid_ros.gap import candidates as library
from geomid_ros.gap.candidates import Candidate, EffectTerm
from geomid_ros.gap.judgement import naming, unsure
from geomid_ros.gap.search.beam_search import Search
from geomid_ros.model.effects import EFFECTS, AtJoint, Quantity
from geomid_ros.model.effects.coulomb_friction import CoulombFriction

from . import planted, small

MODEL = planted.model()
PLACE = AtJoint(0)
STRIBECK = EFFECTS["stribeck_friction"](0.1)
LEVEL, EXCESS = STRIBECK.parts
COULOMB = Candidate(LEVEL, PLACE, (EffectTerm(LEVEL, PLACE),), 1.0)
RICHER = Candidate(STRIBECK, PLACE, (EffectTerm(LEVEL, PLACE), EffectTerm(EXCESS, PLACE)), 3.0)


def level(seed: int, excess: float, alike: bool) -> tuple[Quantity, Quantity]:
    """Of Coulomb friction of level 1 and a little more near standstill: by its own fit, and as unsure as it is."""
    terms = RICHER.terms
    recording = small.Recording(seed, [RICHER], {terms[1]: terms[0]} if alike else None)
    design = recording.design({terms[0]: 1.0, terms[1]: excess}, noise=0.3)
    search = Search(design, small.PRIOR, [COULOMB, RICHER])
    names = search.fit([COULOMB])
    analysis: Any = SimpleNamespace(search=search, names=names)
    own = naming.parameters(MODEL, names, COULOMB)
    return own["level"], unsure.as_unsure(MODEL, analysis, COULOMB, own, 0.0)["level"]


@pytest.mark.parametrize("seed", range(5))
def test_a_level_is_as_unsure_as_the_excess_near_standstill_that_was_not_told(seed: int) -> None:
    """What there is of it passes for a higher level, ten standard deviations of that."""
    own, whole = level(seed, 0.2, alike=True)
    assert abs(own.value - 1.0) > 5.0 * own.std
    assert whole.value == own.value
    assert abs(whole.value - 1.0) < 2.0 * whole.std


@pytest.mark.parametrize("seed", range(3))
def test_what_a_motion_tells_apart_stays_sure(seed: int) -> None:
    own, whole = level(seed, 0.02, alike=False)
    assert own.std <= whole.std < 1.6 * own.std


@pytest.mark.parametrize("had", [CoulombFriction(0.05), LEVEL], ids=["on top", "in its place"])
@pytest.mark.parametrize("seed", range(3))
def test_another_name_counts_with_what_the_model_has_beside_it(seed: int, had: CoulombFriction) -> None:
    """Friction of 3 N m has become 4, which may be larger near standstill: as a whole, or what is on top of the 3."""
    term = EffectTerm(had, PLACE)
    more = Candidate(had, PLACE, (term,), 1.0)
    recording = small.Recording(seed, [more, RICHER])
    recording.columns[term] = recording.columns[RICHER.terms[0]]
    prior = replace(small.PRIOR, terms=(term,), values=np.array([3.0]), spreads=np.array([0.01]))
    search = Search(recording.design({term: 4.0}), prior, [more, RICHER])
    analysis: Any = SimpleNamespace(search=search, names=search.fit([more]))
    own = naming.parameters(MODEL, analysis.names, more)
    whole = unsure.as_unsure(MODEL, analysis, more, own, 0.0)["level"]
    assert abs(whole.value - 4.0) < 3.0 * whole.std
    assert own["level"].std <= whole.std < 0.05


OFFSET, VISCOUS, ROTOR = (small.at(name, 0) for name in ("effort_offset", "viscous_friction", "rotor_inertia"))
ELSEWHERE = tuple(small.at(name, 1) for name in ("viscous_friction", "rotor_inertia"))


def offset(viscous: float, chosen: list[Candidate], *, twin: Candidate, of: Candidate) -> tuple[Quantity, Quantity]:
    """An offset of 1 beside a friction, as fitted beside the ``chosen`` names, and as unsure as it is; the column of
    ``twin`` is that of a name with a third of the offset's."""
    candidates = [OFFSET, VISCOUS, ROTOR, *ELSEWHERE]
    recording = small.Recording(3, candidates)
    recording.columns[twin.terms[0]] = recording.columns[of.terms[0]] + recording.columns[OFFSET.terms[0]] / 3.0
    design = recording.design({OFFSET.terms[0]: 1.0, VISCOUS.terms[0]: viscous, ELSEWHERE[0].terms[0]: 0.5})
    search = Search(design, small.PRIOR, candidates)
    analysis: Any = SimpleNamespace(search=search, names=search.fit([OFFSET, *chosen]))
    own = naming.parameters(MODEL, analysis.names, OFFSET)
    assert unsure.as_unsure(MODEL, analysis, OFFSET, own, 0.0) == own
    return own["offset"], unsure.as_unsure_beside_others(MODEL, analysis, OFFSET, own, 0.0)["offset"]


def test_a_size_is_as_unsure_as_the_rival_of_another_name_would_leave_it() -> None:
    own, whole = offset(0.5, [ROTOR, ELSEWHERE[0]], twin=ROTOR, of=VISCOUS)
    assert abs(own.value - 1.0) > 10.0 * own.std
    assert abs(whole.value - 1.0) < 2.0 * whole.std


def test_a_size_is_as_unsure_as_a_name_more_would_leave_it() -> None:
    """Too little of it to be named, and alike."""
    own, whole = offset(0.02, [ELSEWHERE[0]], twin=VISCOUS, of=VISCOUS)
    assert whole.std > own.std
    assert whole.value == own.value


def test_names_at_other_joints_make_no_size_unsure() -> None:
    own, whole = offset(0.0, [ELSEWHERE[1]], twin=ELSEWHERE[1], of=ELSEWHERE[0])
    assert whole.std < 1.5 * own.std


@pytest.mark.parametrize("effect", ["viscous_friction", "rotor_inertia"])
def test_what_nothing_contains_is_as_sure_as_its_fit(effect: str) -> None:
    candidate = small.at(effect, 0)
    recording = small.Recording(1, [candidate])
    search = Search(recording.design({candidate.terms[0]: 1.0}), small.PRIOR, [candidate])
    analysis: Any = SimpleNamespace(search=search, names=search.fit([candidate]))
    own = naming.parameters(MODEL, analysis.names, candidate)
    assert unsure.as_unsure(MODEL, analysis, candidate, own, 0.0) == own


@pytest.mark.parametrize(("gain", "expected"), [(1.0, 0.1), (0.7, np.hypot(0.1, 0.6)), (1.05, np.hypot(0.1, 0.1))])
def test_a_payload_is_as_unsure_as_gains_beside_it_have_changed(gain: float, expected: float) -> None:
    """Nothing tells 2 kg at seven tenths of the gain from 1.4 kg."""
    changed = small.at("effort_gain", 0)
    found = SimpleNamespace(chosen=(changed, small.PAYLOAD), value=lambda _: gain - 1.0)
    analysis: Any = SimpleNamespace(names=found)
    sizes = {"mass": Quantity(2.0, 0.1, "kg"), "com_x": Quantity(0.2, 0.01, "m")}
    wider = unsure.as_unsure(MODEL, analysis, small.PAYLOAD, sizes, 0.0)
    assert wider["mass"].value == 2.0
    assert wider["mass"].std == pytest.approx(expected)
    assert wider["com_x"] == sizes["com_x"]


@pytest.mark.parametrize(
    ("effect", "was", "sizes", "expected"),
    [
        ("viscous_friction", {}, {"coefficient": (-2.0, 0.3, "N m s/rad")}, {"coefficient": 0.5}),
        ("viscous_friction", {"coefficient": 1.5}, {"coefficient": (2.0, 0.0, "N m s/rad")}, {"coefficient": 0.1}),
        ("effort_gain", {}, {"gain": (0.7, 0.08, "")}, {"gain": 0.1}),
        ("coulomb_friction", {}, {"level": (2.0, 0.3, "N m"), "smoothing": (5.0, 0.1, "rad/s")}, {"level": 0.5}),
        (
            "spring",
            {},
            {"stiffness": (20.0, 3.0, "N m/rad"), "equilibrium": (0.5, 0.0, "rad")},
            {"stiffness": 5.0, "equilibrium": 0.1},
        ),
        (
            "gravity_tilt",
            {},
            {"tilt_x": (0.0, 0.3, "rad"), "tilt_y": (-2.0, 0.0, "rad")},
            {"tilt_x": 0.5, "tilt_y": 0.4},
        ),
    ],
    ids=["alone", "changed", "a gain", "with a constant", "of two units", "of two axes"],
)
def test_a_size_is_as_unsure_as_what_has_no_name_leaves_it(
    effect: str, was: dict[str, float], sizes: dict[str, tuple[float, float, str]], expected: dict[str, float]
) -> None:
    """A fifth of what it changes, in the direction of its largest part."""
    candidate = next(c for c in library.candidates(MODEL) if c.name == effect)
    own = {name: Quantity(*size) for name, size in sizes.items()}
    wider = unsure.as_unsure_beside_remainder(candidate, own, was, 0.2)
    assert {name: quantity.value for name, quantity in wider.items()} == {n: q.value for n, q in own.items()}
    assert {name: quantity.std for name, quantity in wider.items() if quantity != own[name]} == pytest.approx(expected)


@pytest.mark.parametrize(
    ("effect", "was", "sizes", "expected"),
    [
        ("viscous_friction", {}, {"coefficient": (0.5, 0.24, "N m s/rad")}, False),
        ("viscous_friction", {}, {"coefficient": (0.5, 0.26, "N m s/rad")}, True),
        ("viscous_friction", {"coefficient": 1.0}, {"coefficient": (0.5, 0.24, "N m s/rad")}, False),
        ("viscous_friction", {"coefficient": 1.0}, {"coefficient": (0.5, 0.26, "N m s/rad")}, True),
        ("effort_gain", {}, {"gain": (1.04, 0.03, "-")}, True),
        ("effort_gain", {}, {"gain": (1.04, 0.01, "-")}, False),
        ("coulomb_friction", {}, {"level": (0.5, 0.3, "N m"), "smoothing": (0.02, 0.001, "rad/s")}, True),
        ("gravity_tilt", {}, {"tilt_x": (0.1, 0.3, "rad"), "tilt_y": (0.3, 0.1, "rad")}, False),
    ],
)
def test_an_interval_may_hold_what_was_before(
    effect: str, was: dict[str, float], sizes: dict[str, tuple[float, float, str]], expected: bool
) -> None:
    """That of every size has to, constants apart."""
    candidate = next(c for c in library.candidates(MODEL) if c.name == effect)
    own = {name: Quantity(*size) for name, size in sizes.items()}
    assert unsure.may_be_as_before(candidate, own, was) is expected
