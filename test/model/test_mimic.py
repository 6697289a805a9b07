"""Joints that mimic others: they follow, and what moves them is part of their masters' efforts (fault 93)."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from geomid_ros.errors import InputError
from geomid_ros.files.models.mjcf import mjcf
from geomid_ros.files.models.urdf import with_effects
from geomid_ros.model.dynamics import Dynamics
from geomid_ros.model.effects import EFFECTS, KnownEffect, OnLink, Quantity, identified_effect
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

from .robots import random_samples

FACTORS = {"lift": 1.0, "turn": 1.0, "grip": 1.0, "other_finger": -1.0, "crank": 0.5, "crank_of_crank": -0.25}
OFFSETS = {"crank": 0.2, "crank_of_crank": 0.0}
MASTERS = {"lift": 0, "turn": 1, "grip": 2, "other_finger": 2, "crank": 1, "crank_of_crank": 1}


def link(name: str, mass: float, com: str) -> str:
    inertia = f'<inertia ixx="{0.02 * mass}" iyy="{0.03 * mass}" izz="{0.015 * mass}" ixy="0" ixz="0" iyz="0"/>'
    return f'<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass}"/>{inertia}</inertial></link>'


def joint(name: str, kind: str, parent: str, axis: str, origin: str, mimic: str = "") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{name}_link"/><origin xyz="{origin}"'
        f'/><axis xyz="{axis}"/><limit lower="-3" upper="3" effort="9" velocity="9"/>{mimic}</joint>'
    )


def description(masses: dict[str, float], follow: bool = True) -> str:
    """An arm of two joints with a gripper of two fingers and a linkage of two cranks."""
    names = {name: mimic if follow else "" for name, mimic in {
        "other_finger": '<mimic joint="grip" multiplier="-1"/>',
        "crank": '<mimic joint="turn" multiplier="0.5" offset="0.2"/>',
        "crank_of_crank": '<mimic joint="crank" multiplier="-0.5" offset="0.1"/>',
    }.items()}  # fmt: skip
    return "".join([
        '<robot name="gripper"><link name="base"/>',
        *(link(f"{name}_link", mass, f"0.0{place + 1} 0.02 0.1") for place, (name, mass) in enumerate(masses.items())),
        joint("lift", "revolute", "base", "0 1 0", "0 0 0.2"),
        joint("turn", "revolute", "lift_link", "1 0 0", "0 0 0.3"),
        joint("grip", "prismatic", "turn_link", "0 1 0", "0 0.01 0.2"),
        joint("other_finger", "prismatic", "turn_link", "0 1 0", "0 -0.01 0.2", names["other_finger"]),
        joint("crank", "revolute", "turn_link", "0 1 0.3", "0.1 0 0.1", names["crank"]),
        joint("crank_of_crank", "revolute", "crank_link", "0 1 0", "0.1 0 0", names["crank_of_crank"]),
        "</robot>",
    ])  # fmt: skip


MASSES = {"lift": 2.0, "turn": 1.5, "grip": 0.6, "other_finger": 0.6, "crank": 0.9, "crank_of_crank": 0.4}


class Whole:
    """All six joints in pinocchio, moved by hand as the three are."""

    def __init__(self) -> None:
        self.model = pin.buildModelFromXML(description(MASSES, follow=False))
        self.data = self.model.createData()

    def motion(self, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        position, velocity = np.zeros(6), np.zeros(6)
        for name, master in MASTERS.items():
            place = self.model.joints[self.model.getJointId(name)].idx_v
            position[place] = FACTORS[name] * q[master] + OFFSETS.get(name, 0.0)
            velocity[place] = FACTORS[name] * v[master]
        return position, velocity

    def energy(self, q: FloatArray, v: FloatArray) -> float:
        position, velocity = self.motion(q, v)
        kinetic = pin.computeKineticEnergy(self.model, self.data, position, velocity)
        return float(kinetic + pin.computePotentialEnergy(self.model, self.data, position))


def samples_of(robot: Robot, q: FloatArray, v: FloatArray, a: FloatArray) -> Samples:
    """One instant."""
    values = vars(random_samples(robot, 0, 1))
    return Samples(**{**values, "position": q[None], "velocity": v[None], "acceleration": a[None]})


def test_they_are_not_joints_of_their_own() -> None:
    robot = Robot(description(MASSES))
    assert robot.joint_names == ("lift", "turn", "grip")
    assert set(robot.body_names) == {f"{name}_link" for name in MASSES}
    with_friction = MeasurementModel(robot, [identified_effect("viscous_friction")])
    assert [c.place_name for c in with_friction.coefficients] == ["lift", "turn", "grip"]
    assert Robot(description(MASSES), locked_joints=["turn"]).joint_names == ("lift", "grip")
    assert Robot(description(MASSES), locked_joints=["turn"]).mimic_joints[0].joint.name == "other_finger"
    assert Robot(description(MASSES), locked_joints=["crank"]).joint_names == ("lift", "turn", "grip")


def test_the_masters_efforts_make_the_energy_grow() -> None:
    """Work per time, by rows and by recursion, is the change of kinetic and potential energy."""
    robot = Robot(description(MASSES))
    model = MeasurementModel(robot, ())
    whole, step = Whole(), 1e-5
    for q, v, a in np.random.default_rng(3).normal(size=(10, 3, 3)):
        samples = samples_of(robot, q, v, a)
        dynamics = Dynamics(model, model.nominal_inertias.reshape(-1, 10))
        by_rows = model.predict(samples, model.nominal_parameters)[1][0]
        ahead = whole.energy(q + step * v + 0.5 * step**2 * a, v + step * a)
        behind = whole.energy(q - step * v + 0.5 * step**2 * a, v - step * a)
        power = (ahead - behind) / (2.0 * step)
        assert by_rows @ v == pytest.approx(power, rel=1e-6, abs=1e-6)
        np.testing.assert_allclose(dynamics.efforts(samples)[0], by_rows, rtol=1e-9, atol=1e-9)


def test_a_channel_depends_on_its_columns_alone() -> None:
    """The bodies that followers move are among those of their masters."""
    robot = Robot(description(MASSES))
    model = MeasurementModel(robot, [])
    rows = model.rows(random_samples(robot, seed=1)).coefficients
    for index, channel in enumerate(model.channels):
        others = np.setdiff1d(np.arange(model.dimension), channel.columns)
        assert not np.any(rows[:, index, others])


def test_derivatives_are_those_of_the_efforts() -> None:
    robot = Robot(description(MASSES))
    model = MeasurementModel(robot, ())
    dynamics = Dynamics(model, model.nominal_inertias.reshape(-1, 10))
    motion = np.random.default_rng(4).normal(size=(3, 3))
    found = dynamics.sensitivity(samples_of(robot, *motion))
    terms = [getattr(found, name) for name in vars(found)][:3]
    for kind, term in enumerate(terms):
        for place in range(3):
            step = np.zeros((3, 3))
            step[kind, place] = 1e-6
            ahead, behind = (dynamics.efforts(samples_of(robot, *(motion + sign * step)))[0] for sign in (1, -1))
            np.testing.assert_allclose(term[0, :, place], (ahead - behind) / 2e-6, rtol=1e-6, atol=1e-6)


def test_one_that_follows_itself_is_refused() -> None:
    text = description(MASSES).replace('<mimic joint="turn"', '<mimic joint="crank_of_crank"')
    with pytest.raises(InputError, match="joint 'crank' mimics itself"):
        Robot(text)


def test_one_that_follows_nobody_is_a_joint() -> None:
    text = description(MASSES).replace('<mimic joint="grip"', '<mimic joint="of_another_robot"')
    assert Robot(text).joint_names == ("lift", "turn", "grip", "other_finger")


@pytest.mark.parametrize("locked", [[], ["grip"], ["turn", "grip"]])
def test_in_the_mjcf_they_are_tied_to_their_masters(locked: list[str]) -> None:
    """Of which some were locked: in the file they move, with their own masses."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(mjcf(Robot(description(MASSES), locked_joints=locked), {}))
    assert {name: model.body(f"{name}_link").mass[0] for name in MASSES} == pytest.approx(MASSES)
    assert model.nu == 3
    assert model.njnt == 6
    tied = {
        (model.joint(first).name, model.joint(second).name): tuple(data[:2])
        for first, second, data in zip(model.eq_obj1id, model.eq_obj2id, model.eq_data, strict=True)
    }
    assert tied == {
        ("other_finger", "grip"): (0.0, -1.0),
        ("crank", "turn"): (0.2, 0.5),
        ("crank_of_crank", "turn"): (pytest.approx(0.0), -0.25),
    }


def test_friction_of_a_follower_is_its_masters() -> None:
    """By virtual work; a file in which a master's was identified has none at its followers."""
    text = description(MASSES).replace("<limit", '<dynamics damping="2" friction="3"/><limit')
    described = Robot(text).described_dynamics
    assert described["grip", "dynamics/damping"] == 4.0
    assert described["grip", "dynamics/friction"] == 6.0
    assert described["turn", "dynamics/damping"] == pytest.approx(2.0 * (1.0 + 0.5**2 + 0.25**2))
    assert described["turn", "dynamics/friction"] == pytest.approx(3.0 * (1.0 + 0.5 + 0.25))
    quantity = {"coefficient": Quantity(5.0, np.nan, "N m s/rad")}
    written = with_effects(text, [KnownEffect("viscous_friction", "turn", "", quantity)])
    assert Robot(written).described_dynamics == described | {("turn", "dynamics/damping"): 5.0}


def test_what_moves_a_link_is_the_joint_that_its_own_follows() -> None:
    """So that a load on a finger that follows is not on the hand, which moves without it."""
    model = MeasurementModel(Robot(description(MASSES)), ())
    own = [place for place in model.places.of(EFFECTS["payload"]()) if isinstance(place, OnLink)]
    moved = {model.body_names[place.link]: model.places.name(place) for place in own}
    movers = {f"{name}_link": model.robot.joint_names[master] for name, master in MASTERS.items()}
    assert moved == {name: movers[name] for name in model.body_names}
    assert len(moved) == 6
