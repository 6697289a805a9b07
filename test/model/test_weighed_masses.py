"""Weighed masses: how they are written, which rows they make, and what cannot be weighed."""

from __future__ import annotations

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.effects import identifiable
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.weighed_masses import WeighedMass, weighed_rows

INERTIA = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
MASSES = {"base": 7.0, "upper": 3.0, "cover": 0.5, "fore": 2.0, "plate": 0.0, "tool": 0.25, "frame": 0.0}
JOINTS = (("revolute", "base", "upper"), ("fixed", "upper", "cover"), ("revolute", "upper", "fore"),
          ("fixed", "fore", "plate"), ("fixed", "plate", "tool"), ("revolute", "fore", "frame"))  # fmt: skip
URDF = (
    '<robot name="arm">'
    + "".join(
        f'<link name="{name}">' + (f'<inertial><mass value="{mass}"/>{INERTIA}</inertial>' if mass else "") + "</link>"
        for name, mass in MASSES.items()
    )
    + "".join(
        f'<joint name="{child}_joint" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        '<axis xyz="0 1 0"/><limit effort="1" velocity="1"/></joint>'
        for kind, parent, child in JOINTS
    )
    + "</robot>"
)


def model(links: list[str] | None = None) -> MeasurementModel:
    return MeasurementModel(Robot(URDF), [identifiable()["viscous_friction"]], links=links)


def row(text: str, links: list[str] | None = None) -> tuple[dict[str, float], float, float]:
    """Coefficients of the bodies' masses, the mass on the other side, and the standard deviation."""
    own, given = model(links), WeighedMass.parse(text)
    known = weighed_rows(own, [given])
    (coefficients,), (target,) = known.rows * given.std, known.targets * given.std
    names = own.body_names
    masses = {name: coefficients[10 * place] for place, name in enumerate(names) if coefficients[10 * place]}
    coefficients[[10 * place for place in range(len(names))]] = 0.0
    assert not np.any(coefficients)
    return masses, pytest.approx(target), given.std


@pytest.mark.parametrize(
    ("text", "links", "mass", "std"),
    [
        ("total=23.4:0.05", ("total",), 23.4, 0.05),
        ("upper = 2 : 1e-3", ("upper",), 2.0, 1e-3),
        ("a + b=2:1", ("a", "b"), 2.0, 1.0),
        ("a=b=2:1", ("a=b",), 2.0, 1.0),
    ],
)
def test_how_they_are_written(text: str, links: tuple[str, ...], mass: float, std: float) -> None:
    assert WeighedMass.parse(text) == WeighedMass(links, mass, std)


@pytest.mark.parametrize(
    "text",
    ["", "a", "a=2", "a=2:0", "a=-2:1", "a=2:nan", "a=2:1e-5", "a=x:1", "=2:1", "a+=2:1", "a+a=2:1", "a=2:1:1"],
)
def test_how_they_are_not_written(text: str) -> None:
    with pytest.raises(InputError, match="is not of the form LINK=MASS:STD"):
        WeighedMass.parse(text)


@pytest.mark.parametrize(
    ("text", "links", "masses", "unknown"),
    [
        ("fore=2.2:0.1", None, {"fore": 1.0}, 2.2),  # with what is fixed to it
        ("upper+fore=6:0.1", None, {"upper": 1.0, "fore": 1.0}, 6.0),
        ("total=12:0.1", None, {"upper": 1.0, "fore": 1.0}, 12.0 - MASSES["base"]),  # with what does not move
        ("total=12:0.1", ["fore"], {"fore": 1.0}, 12.0 - 7.0 - 3.5),  # others have the URDF's mass
        ("upper+fore=6:0.1", ["fore"], {"fore": 1.0}, 6.0 - 3.5),
    ],
)
def test_a_row_sums_the_masses_of_bodies(
    text: str, links: list[str] | None, masses: dict[str, float], unknown: float
) -> None:
    assert row(text, links) == (masses, unknown, 0.1)


def test_of_a_floating_robot_everything_is_unknown() -> None:
    plate = WrenchSensor("plate", "odom", "external")
    from_plate = MeasurementModel(Robot(URDF, floating_base=True), [], [plate])
    known = weighed_rows(from_plate, [WeighedMass.parse("total=12:1")])
    assert from_plate.body_names == ("base", "upper", "fore")
    np.testing.assert_array_equal(known.rows[0, ::10], 1.0)
    np.testing.assert_array_equal(known.targets, [12.0])


@pytest.mark.parametrize(
    ("text", "links", "message"),
    [
        ("uper=2:1", None, "unknown link of a weighed mass 'uper'. Did you mean 'upper'? Valid: fore, total, upper"),
        ("cover=2:1", None, "it is fixed to 'upper' and identified as one body with it: give .* as upper=MASS:STD"),
        ("tool=2:1", None, "it is fixed to 'fore'"),
        ("plate=2:1", None, "it is fixed to 'fore'"),
        ("base=2:1", None, "it does not move, or has no mass in the URDF"),
        ("frame=2:1", None, "it does not move, or has no mass in the URDF"),
        ("upper=2:1", ["fore"], "the mass of upper is given, but none of these links is identified"),
        ("total=6:1", None, "total: weighed mass 6 kg is not above the URDF mass 7 kg of its links"),
    ],
)
def test_what_cannot_be_weighed(text: str, links: list[str] | None, message: str) -> None:
    with pytest.raises(InputError, match=message.replace("?", r"\?")):
        weighed_rows(model(links), [WeighedMass.parse(text)])
