"""A gantry whose driver smooths its velocities, and so sends them late: its links keep their weight."""

from __future__ import annotations

from functools import cache

import numpy as np
from signals.feeding import feed, regular, seconds
from signals.sent import JointMessage

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.estimation.estimator import EstimatorSettings
from geomid_ros.estimation.identifier import Identifier
from geomid_ros.model.effects import identifiable
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.signals.pipeline import SignalPipeline
from geomid_ros.signals.settings import SignalSettings
from geomid_ros.types import FloatArray

JOINTS = ("across", "up")
URDF_MASSES = {"beam": 14.0, "ram": 4.0}
MASSES = np.array([12.0, 3.4])  # of beam and ram
ROTORS = np.array([0.8, 0.3])  # [kg] at either axis
DELAY = 0.018  # [s] of a usual low-pass at 10 Hz


def link(name: str, mass: float) -> str:
    inertia = f'<inertia ixx="{0.1 * mass}" iyy="{0.1 * mass}" izz="{0.1 * mass}" ixy="0" ixz="0" iyz="0"/>'
    return f'<link name="{name}"><inertial><mass value="{mass}"/>{inertia}</inertial></link>'


def joint(name: str, parent: str, child: str, axis: str) -> str:
    limit = '<limit lower="-1" upper="1" effort="999" velocity="2"/>'
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="prismatic">{ends}<axis xyz="{axis}"/>{limit}</joint>'


@cache
def estimated(delay: float) -> Estimate:
    """What is found with velocities that are so late [s]."""
    links = "".join(link(*own) for own in URDF_MASSES.items())
    joints = joint("across", "frame", "beam", "1 0 0") + joint("up", "beam", "ram", "0 0 1")
    model = MeasurementModel(
        Robot(f'<robot name="gantry"><link name="frame"/>{links}{joints}</robot>'),
        [identifiable()[name] for name in ("viscous_friction", "coulomb_friction", "rotor_inertia", "effort_offset")],
    )
    settings = SignalSettings(period=0.01)
    pipeline = SignalPipeline(JOINTS, settings=settings, effect_columns=model.columns)
    identifier = Identifier(model, EstimatorSettings(cutoff=settings.cutoff))
    identifier.add(feed(pipeline, messages(delay)))
    return identifier.solve()


def messages(delay: float) -> list[JointMessage]:
    """40 s of sines, and what they take: Newton's second law, weight, friction and noise of 0.1 N."""
    stamps = regular(0.01, 40.0)
    rates = 2.0 * np.pi * np.array([[0.11, 0.23, 0.41], [0.13, 0.29, 0.37]])
    sizes = np.array([[0.4, 0.1, 0.05], [0.2, 0.1, 0.05]])

    def derivative(order: int, late: float = 0.0) -> FloatArray:
        phases = (seconds(stamps) - late)[:, None, None] * rates + 0.5 * np.pi * order
        return np.asarray(np.sum(sizes * rates**order * np.sin(phases), axis=2))

    carried = np.array([np.sum(MASSES), MASSES[1]])
    weight = np.array([0.0, 9.81 * MASSES[1]])
    friction = 2.0 * derivative(1) + 3.0 * np.sign(derivative(1))
    noise = 0.1 * np.random.default_rng(0).normal(size=(len(stamps), 2))
    efforts = (carried + ROTORS) * derivative(2) + weight + friction + noise
    numbers = zip(stamps.tolist(), derivative(0), derivative(1, delay), efforts, strict=True)
    return [JointMessage(stamp, JOINTS, *own) for stamp, *own in numbers]


def test_late_velocities_move_no_mass_into_rotors() -> None:
    """Rotors and links move as one: what a late velocity makes of the links' acceleration must not tell them apart."""
    found = estimated(DELAY)
    masses = np.array([each.mass for each in found.links])
    np.testing.assert_allclose(masses, MASSES, rtol=0.3)
    np.testing.assert_allclose(masses, [each.mass for each in estimated(0.0).links], rtol=0.05)
