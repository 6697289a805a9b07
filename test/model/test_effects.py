"""The contract of effects, held against every file of their folder."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from geomid_ros.model import effects
from geomid_ros.model.effects import DEFAULT_EFFECTS, EFFECTS, Effect, JointMotion
from geomid_ros.model.effects.effect import PhysicalEffect

FUNCTIONS_OF_MOTION = {name: cls for name, cls in EFFECTS.items() if issubclass(cls, Effect)}
# What files/urdf.py and files/mjcf.py write: attributes of a joint by themselves, elements by code of their own.
WRITTEN = {
    "urdf": r"|dynamics/(damping|friction)|link/inertial",
    "mjcf": r"|joint/(damping|frictionloss|armature|stiffness|springref)|option/gravity|body/inertial"
    r"|(elasticity|backlash)/(stiffness|range|damping)",
}


def test_every_file_is_known() -> None:
    contracts = {"__init__", "effect", "parameters", "situation"}
    files = {path.stem for path in Path(effects.__file__).parent.glob("*.py")} - contracts
    assert {cls.__module__.rpartition(".")[2] for cls in EFFECTS.values()} == files
    assert files == set(EFFECTS)


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS)
def test_an_effect_describes_itself(effect: type[PhysicalEffect]) -> None:
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


def test_what_can_be_identified_has_one_parameter() -> None:
    assert set(DEFAULT_EFFECTS) <= set(EFFECTS)
    assert not {"spring", "stribeck_friction"} & set(EFFECTS)
    for name, effect in EFFECTS.items():
        (form,) = effect.parameters
        assert (effect.name, effect.units, effect.positive) == (name, form.units, form.above == 0.0)


@pytest.mark.parametrize("effect", FUNCTIONS_OF_MOTION.values(), ids=FUNCTIONS_OF_MOTION)
def test_a_column_is_of_each_instant_by_itself(effect: type[Effect]) -> None:
    motion = np.random.default_rng(1).normal(size=(3, 40))
    column = effect().column(JointMotion(*motion))
    assert column.shape == (40,)
    assert np.all(np.isfinite(column))
    assert np.any(column != 0.0)
    some = np.random.default_rng(2).permutation(40)[:7]
    np.testing.assert_array_equal(effect().column(JointMotion(*motion[:, some])), column[some])


def test_two_effects_of_one_name_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As after copying a file and forgetting to give the new one its name."""
    text = (Path(effects.__file__).parent / "viscous_friction.py").read_text(encoding="utf-8")
    (tmp_path / "copied_effect.py").write_text(text, encoding="utf-8")
    monkeypatch.setattr(effects, "__path__", [*effects.__path__, str(tmp_path)])
    with pytest.raises(TypeError, match=r"copied_effect.*viscous_friction.*same name"):
        effects._collected()
    del sys.modules["geomid_ros.model.effects.copied_effect"]
