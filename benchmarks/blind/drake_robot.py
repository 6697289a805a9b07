"""The second simulator: rigid bodies by Drake, and a friction that is neither MuJoCo's nor a jump."""

from __future__ import annotations

import importlib
from collections.abc import Iterable
from typing import Any
from xml.etree import ElementTree

import numpy as np
from defusedxml import ElementTree as Reader

from geomid_ros.simulation.description import Description, LinkInertia
from geomid_ros.simulation.effects import TrueEffect, payload_inertia, play_name, rotation
from geomid_ros.simulation.options import GEARS
from geomid_ros.simulation.plant import GRAVITY, Simulator
from geomid_ros.types import FloatArray

_CREEP = 0.01  # rad/s; dry friction has 71 % of its level here, 99.5 % at ten times as much


def available() -> bool:
    """Whether Drake can be imported."""
    try:
        importlib.import_module("pydrake.multibody.plant")
    except ImportError:
        return False
    return True


class DrakeRobot(Simulator):
    """A robot in Drake, its joints in the order of the URDF, each followed by the hinge of a gear that gives.

    Drake knows the links only, at angles ``S q`` of the state q, where S adds each gear's hinge to its motor. The
    state obeys ``(S^T M S + rotors) a + S^T b + passive efforts = motors' efforts``.
    """

    def __init__(
        self,
        description: Description,
        bodies: Iterable[LinkInertia],
        effects: Iterable[TrueEffect] = (),
        wrench_frame: str | None = None,
    ) -> None:
        effects = tuple(effects)
        joints = [joint.name for joint in description.joints]
        giving = {effect.joint for effect in effects if effect.name in GEARS}
        names = [name for joint in joints for name in (joint, play_name(joint)) if name == joint or joint in giving]
        super().__init__(names, joints, effects)
        self._limit = np.array([joint.effort for joint in description.joints])
        self._spread = np.array([[float(name in (joint, play_name(joint))) for name in names] for joint in joints])
        self._set_hinges(len(names))
        loads = [payload_inertia(effect) for effect in effects if effect.name == "payload"]
        self._plant = _drake_plant(description, [*bodies, *loads], _gravity(effects))
        self._context = self._plant.CreateDefaultContext()
        self._weight = importlib.import_module("pydrake.multibody.tree").MultibodyForces(self._plant)
        self._order = np.array([self._plant.GetJointByName(name).velocity_start() for name in joints])
        self._sensor = None
        if wrench_frame is not None:
            self._sensor = int(self._plant.GetJointByName(description.edges[wrench_frame].joint).index())

    def _set_hinges(self, count: int) -> None:
        """Springs, dampers and rotors at every hinge."""
        self._stiffness, self._equilibrium, self._damping, self._rotor = np.zeros((4, count))
        for effect, at in self._places:
            values = effect.parameters
            if effect.name == "viscous_friction":
                self._damping[at.joint] += values["coefficient"]
            elif effect.name == "rotor_inertia":
                self._rotor[at.joint] += values["inertia"]
            elif effect.name == "spring":
                self._stiffness[at.joint], self._equilibrium[at.joint] = values["stiffness"], values["equilibrium"]
            elif effect.name == "joint_elasticity":
                self._stiffness[at.play], self._damping[at.play] = values["stiffness"], values["damping"]
            if effect.name in GEARS:
                self._rotor[at.joint] += values["rotor_inertia"]

    def acceleration(self, position: FloatArray, velocity: FloatArray, effort: FloatArray) -> FloatArray:
        self._effort = np.clip(effort, -self._limit, self._limit)
        inertia, bias = self._equation(position, velocity)
        friction = self._friction_levels(position, velocity, self._effort) * velocity / np.hypot(velocity, _CREEP)
        driving = -bias - friction
        driving[self.driven] += self._effort
        self._accelerations = np.asarray(np.linalg.solve(inertia, driving), dtype=np.float64)
        return self._accelerations.copy()

    def _equation(self, position: FloatArray, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The inertia matrix ``(m, m)`` of a state, and all efforts ``(m,)`` it takes without acceleration."""
        self._place(position, velocity)
        inertia = self._plant.CalcMassMatrix(self._context)[np.ix_(self._order, self._order)]
        weight = self._plant.CalcGravityGeneralizedForces(self._context)
        bias = (self._plant.CalcBiasTerm(self._context) - weight)[self._order]
        passive = self._stiffness * (position - self._equilibrium) + self._damping * velocity
        spread = self._spread
        return (
            spread.T @ inertia @ spread + np.diag(self._rotor),
            spread.T @ bias + passive + self._needed(position, velocity),
        )

    def _place(self, position: FloatArray, velocity: FloatArray) -> None:
        angles, speeds = np.zeros((2, len(self._order)))
        angles[self._order], speeds[self._order] = self._spread @ position, self._spread @ velocity
        self._plant.SetPositions(self._context, angles)
        self._plant.SetVelocities(self._context, speeds)

    def effort(self) -> FloatArray:
        return self._effort

    def wrench(self) -> FloatArray:
        if self._sensor is None:
            return np.empty(0)
        wanted = np.zeros(len(self._order))
        wanted[self._order] = self._spread @ self._accelerations
        self._plant.CalcForceElementsContribution(self._context, self._weight)
        driving = self._plant.CalcInverseDynamics(self._context, wanted, self._weight)
        self._plant.get_applied_generalized_force_input_port().FixValue(self._context, driving)
        reaction = self._plant.get_reaction_forces_output_port().Eval(self._context)[self._sensor]
        return np.concatenate([reaction.translational(), reaction.rotational()])

    def inverse_dynamics(self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
        inertia, bias = self._equation(position, velocity)
        effort: FloatArray = inertia @ acceleration + bias
        return effort

    def inertia_matrix(self, position: FloatArray) -> FloatArray:
        return self._equation(position, np.zeros(len(position)))[0]


def _gravity(effects: Iterable[TrueEffect]) -> FloatArray:
    gravity = np.array([0.0, 0.0, -GRAVITY])
    for effect in effects:
        if effect.name == "gravity_tilt":
            gravity = rotation(effect.parameters["tilt_x"], effect.parameters["tilt_y"]).T @ gravity
    return gravity


def _drake_plant(description: Description, bodies: Iterable[LinkInertia], gravity: FloatArray) -> Any:
    module = importlib.import_module("pydrake.multibody.plant")
    plant = module.MultibodyPlant(0.0)
    parsing = importlib.import_module("pydrake.multibody.parsing")
    parsing.Parser(plant).AddModelsFromString(_urdf(description, bodies), "urdf")
    if description.root != plant.world_body().name():  # a link of that name is Drake's world already
        plant.WeldFrames(plant.world_frame(), plant.GetFrameByName(description.root))
    plant.mutable_gravity_field().set_gravity_vector(gravity)
    plant.Finalize()
    return plant


def _urdf(description: Description, bodies: Iterable[LinkInertia]) -> str:
    """The kinematic tree without limits, with true inertias; the bodies of a link are welded to it."""
    robot = Reader.fromstring(description.kinematics)
    for joint in robot.findall("joint"):
        for limit in joint.findall("limit"):
            joint.remove(limit)
    for index, body in enumerate(bodies):
        name = f"{body.name}/{index}"
        inertial = ElementTree.SubElement(ElementTree.SubElement(robot, "link", name=name), "inertial")
        ElementTree.SubElement(inertial, "origin", xyz=_words(body.com), rpy="0 0 0")
        ElementTree.SubElement(inertial, "mass", value=repr(float(body.mass)))
        values = {a + b: body.inertia["xyz".index(a), "xyz".index(b)] for a, b in ("xx", "xy", "xz", "yy", "yz", "zz")}
        ElementTree.SubElement(inertial, "inertia", {f"i{key}": repr(float(value)) for key, value in values.items()})
        weld = ElementTree.SubElement(robot, "joint", name=f"{name}/weld", type="fixed")
        ElementTree.SubElement(weld, "parent", link=body.name)
        ElementTree.SubElement(weld, "child", link=name)
    return ElementTree.tostring(robot, encoding="unicode")


def _words(values: FloatArray) -> str:
    return " ".join(repr(float(value)) for value in values)
