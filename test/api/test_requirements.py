"""What a user requires of a model: parsed without being run, compared with numbers, refused in one sentence."""

from __future__ import annotations

import math

import pytest

from geomid_ros.api.verify import Requirement
from geomid_ros.errors import InputError

VALUES = {
    "rms": {
        "joint1": {"value": 3.0, "floor": 2.0, "urdf": 10.0},
        "wrist/ft.x/fx": {"value": 1.0, "floor": 0.25, "urdf": 4.0},
        "unmeasured": {"value": math.nan, "floor": math.nan, "urdf": math.nan},
    },
    "mass": {"link1": {"value": 2.0, "urdf": 4.0}, "total": {"value": 20.0, "urdf": 10.0}},
    "from_data": {"link1": {"value": 0.5}},
}


OPEN = {"unmeasured.rms": None}  # not checked


def passed(text: str) -> dict[str, bool | None]:
    return {outcome.what: outcome.passed for outcome in Requirement.parse(text).checked(VALUES)}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("rms<2*floor", {"joint1.rms": True, "wrist/ft.x/fx.rms": False, **OPEN}),
        ("rms < 4 * floor", {"joint1.rms": True, "wrist/ft.x/fx.rms": False, **OPEN}),
        ("rms<=4*floor", {"joint1.rms": True, "wrist/ft.x/fx.rms": True, **OPEN}),
        ("joint1.rms<3", {"joint1.rms": False}),
        ("joint1.rms<=3.", {"joint1.rms": True}),
        ("wrist/ft.x/fx.rms>=1", {"wrist/ft.x/fx.rms": True}),
        ("mass>0.49*urdf", {"link1.mass": True}),
        ("total.mass<1.5*urdf", {"total.mass": False}),
        ("from_data>=.5", {"link1.from_data": True}),
        ("unmeasured.rms<1e9", {"unmeasured.rms": False}),
        ("unmeasured.rms>0", {"unmeasured.rms": False}),
    ],
)
def test_numbers_are_compared_as_written(text: str, expected: dict[str, bool | None]) -> None:
    assert passed(text) == expected


def test_every_place_is_judged_as_far_as_it_can_be() -> None:
    """A channel that had no efforts when the model was identified has no floor; where nothing can be judged, that is no
    success."""
    rms = {"joint1": {"value": 3.0, "floor": 2.0}, "finger": {"value": 1.0, "floor": math.nan}}
    required = Requirement.parse("rms<2*floor")
    assert [outcome.passed for outcome in required.checked({"rms": rms})] == [True, None]
    with pytest.raises(InputError, match="nothing to check"):
        required.checked({"rms": {"finger": rms["finger"]}})


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "expected"),
        ("rms<-1", "expected"),
        ("rms<__import__('os').getcwd()", "expected"),
        ("a." * 10_000 + "rms<1", "expected"),
        ("rsm<1", "Did you mean 'rms'"),
        ("rms<2*flor", "floor or urdf"),
        ("mass<2*floor", "a number or a multiple of urdf"),
        ("from_data<urdf", "a number, not"),
        ("joint2.rms<1", "Did you mean 'joint1'"),
        ("total.rms<1", "unknown place 'total'"),
        ("unmeasured.rms<2*floor", "the model has no floor for 'unmeasured'"),
    ],
)
def test_what_cannot_be_required_is_refused_with_what_can(text: str, told: str) -> None:
    with pytest.raises(InputError) as refusal:
        passed(text)
    assert told in str(refusal.value)
    assert "\n" not in str(refusal.value)
