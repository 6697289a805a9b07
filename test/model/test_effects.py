"""The contract of effects, held against every file of their folder."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.model import effects
from geomid_ros.model.coefficients import Coefficient
from geomid_ros.model.effects import (
    DEFAULT_CANDIDATES,
    DEFAULT_EFFECTS,
    EFFECTS,
    AtJoint,
    Effect,
    GravityEffect,
    IdentifiedEffect,
    JointEffect,
    JointMotion,
    KnownEffect,
    Quantity,
    SensorEffect,
    identifiable,
    identified_effect,
    register,
)
from geomid_ros.model.effects.friction import ViscousFriction

OF_JOINTS = {name: cls for name, cls in EFFECTS.items() if issubclass(cls, JointEffect)}
# What files/urdf.py and files/mjcf.py write: attributes of a joint by themselves, elements by code of their own.
WRITTEN = {
    "urdf": r"|dynamics/(damping|friction)|link/inertial",
    "mjcf": r"|joint/(damping|frictionloss|armature|stiffness|springref|ref)|option/gravity|body/inertial"
    r"|(elasticity|backlash)/(stiffness|range|damping)|tendon/(coef|damping|frictionloss|armature)",
}


def test_every_file_is_known() -> None:
    contracts = {"__init__", "effect", "parameters", "places", "situation"}
    files = {path.stem for path in Path(effects.__file__).parent.glob("*.py")} - contracts
    assert {cls.__module__.rpartition(".")[2] for cls in EFFECTS.values()} == files


@pytest.mark.parametrize("name", EFFECTS)
def test_what_cannot_be_identified_is_not_found_among_what_can(name: str) -> None:
    if name in identifiable():
        assert type(identified_effect(name)) is EFFECTS[name]
    else:
        with pytest.raises(InputError, match=f"unknown effect '{name}'"):
            identified_effect(name)


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS)
def test_an_effect_describes_itself(effect: type[Effect]) -> None:
    for text in (effect.label, effect.meaning, effect.settled_by):
        assert re.fullmatch(r"\S.*[^\s.]", text), f"{text!r} stands within a sentence"
    names = [form.name for form in effect.parameters]
    assert len(set(names)) == len(names) > 0
    if effect.place in ("joint", "robot"):
        assert all(name in effect.meaning for name in names)
    for form in effect.parameters:
        assert form.above < form.below
        assert all(form.units)
        for file, known in WRITTEN.items():
            assert re.fullmatch(known, getattr(form, file)), f"{file}: nothing writes {getattr(form, file)}"


def test_what_can_be_identified_is_linear_in_coefficients_of_its_own() -> None:
    assert set(DEFAULT_EFFECTS) <= set(identifiable())
    assert set(DEFAULT_CANDIDATES) <= set(identifiable())
    assert not set(DEFAULT_CANDIDATES) & set(DEFAULT_EFFECTS)
    for name, effect in identifiable().items():
        assert effect.name == name
        assert effect.column_parameters
        assert set(effect.column_parameters) <= set(effect.parameters)
        assert len(effect.column_parameters) == effect.count
        assert 0 <= effect.column_positives <= effect.count
        assert len(effect.column_parameters) == 1 or isinstance(effect, SensorEffect | GravityEffect)
        assert effect.column_parameters[0].above != 0.0 or effect.column_positives == 1


@pytest.mark.parametrize("effect", identifiable().values(), ids=identifiable())
def test_what_was_identified_is_known_again(effect: IdentifiedEffect) -> None:
    """By its own coefficient and constants alone, whatever else belongs to the effect."""
    for trial in type(effect).coarse_grid():
        for index, form in enumerate(trial.column_parameters):
            found = Coefficient(
                effect=trial, place=AtJoint(0), index=index, place_name="j", parameter=form.name, unit=form.units[0]
            ).parameters(0.7, 0.1)
            assert found[form.name] == Quantity(0.7, 0.1, form.units[0])
            known = KnownEffect(trial.name, "j", "", found)
            assert {other.name for other in trial.parameters if not other.optional} <= found.keys()
            own = trial.coefficients(known.values)
            assert own[trial][index] == 0.7
            assert all(part == trial for part in own)


@pytest.mark.parametrize("effect", OF_JOINTS.values(), ids=OF_JOINTS)
def test_a_column_is_of_each_instant_by_itself(effect: type[JointEffect]) -> None:
    motion = np.random.default_rng(1).normal(size=(3, 40))
    column = effect().column(JointMotion(motion))
    assert column.shape == (40,)
    assert np.all(np.isfinite(column))
    assert np.any(column != 0.0)
    some = np.random.default_rng(2).permutation(40)[:7]
    np.testing.assert_array_equal(effect().column(JointMotion(motion[:, some])), column[some])


@pytest.mark.parametrize(
    "effect",
    dict.fromkeys(
        e for cls in OF_JOINTS.values() for e in (*cls.grid(), *cls.coarse_grid()) if not e.compensated_in_samples
    ),
    ids=lambda effect: f"{effect.name} {[*vars(effect).values()]}",
)
def test_what_was_chosen_is_known_again_with_its_constants(effect: JointEffect) -> None:
    """A file that says the parameters says the same column."""
    sizes = np.full(len(effect.parts), 0.5)
    said = {name: quantity.value for name, quantity in effect.quantities(sizes, np.zeros((len(sizes),) * 2)).items()}
    again = type(effect).coefficients(said)
    assert {part: again[part] for part in effect.parts} == dict.fromkeys(effect.parts, (0.5,))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("effect", OF_JOINTS.values(), ids=OF_JOINTS)
def test_what_is_not_there_has_parameters_without_a_warning(effect: type[JointEffect]) -> None:
    size = len(effect().parts)
    assert effect().quantities(np.zeros(size), np.zeros((size, size)))


def test_two_effects_of_one_name_are_refused() -> None:
    """As after copying a file and forgetting to give the new one its name."""
    copied = type("CopiedEffect", (ViscousFriction,), {})
    with pytest.raises(TypeError, match=r"ViscousFriction.*CopiedEffect.*same name, 'viscous_friction'"):
        register(copied)
    assert EFFECTS["viscous_friction"] is ViscousFriction
