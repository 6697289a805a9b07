"""A description as it is handed over: written, loaded again by the program that reads it, and judged as itself."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias
from xml.etree.ElementTree import Element

import numpy as np

from geomid_ros.checks.unexplained import WORSE
from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.exports.descriptions import DESCRIPTIONS, RobotToDescribe, Whole
from geomid_ros.files.models.effects_file import coefficients_of, unsaid
from geomid_ros.files.models.estimate_file import model_effects
from geomid_ros.files.models.readers import ELEMENTS, URDF
from geomid_ros.files.models.written_model import WrittenModel, written_model
from geomid_ros.files.schema import entry
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import EFFECTS, Effect, MotionEffect, Place, effect_class
from geomid_ros.model.effects.situation import pair_name, place_named
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.model.urdf_tree import read_xml
from geomid_ros.resimulation.written_robot import load_mujoco
from geomid_ros.session.session import Session, with_inertias_of
from geomid_ros.types import FloatArray

Attributes: TypeAlias = dict[tuple[str, str], float]
"""Numbers of a description by joint and ``ELEMENT/ATTRIBUTE``."""
_PAYLOAD = "/payload"


@dataclass(frozen=True, eq=False)
class ReadBack:
    """What a ``reader`` takes from a description: ``inertias (10,)`` by body, and ``attributes`` of joints."""

    reader: str
    inertias: Mapping[str, FloatArray]
    attributes: Attributes

    def parameters(self, model: MeasurementModel) -> FloatArray:
        """The parameters ``(D,)`` of ``model`` with these inertias and no effects."""
        bodies = [self.inertias[name] for name in model.body_names]
        return np.concatenate([*bodies, np.zeros(len(model.coefficients))])

    def efforts(self, joints: Sequence[str], samples: Samples) -> FloatArray:
        """What the attributes add to the joints' efforts ``(N, joints)``."""
        return samples.efforts_of(self._terms(joints))

    def _terms(self, joints: Sequence[str]) -> Iterator[tuple[MotionEffect, Place, float]]:
        """The effects that the attributes mean, at their places, with their coefficients."""
        taken = set[str]()
        for cls in (each for each in EFFECTS.values() if issubclass(each, MotionEffect)):
            places = {form.name: form.place_in(ELEMENTS[self.reader]) for form in cls.parameters}
            sizes = {places[form.name] for form in cls.variants()[0].own if places[form.name]}
            if not taken & sizes:
                taken |= sizes
                for name in {name for name, at in self.attributes if at in sizes}:
                    values = {key: self.attributes.get((name, place), 0.0) for key, place in places.items()}
                    where = place_named(cls.place, name, joints)
                    yield from _parts(cls, values, where) if where is not None else ()


def _parts(cls: type[Effect], values: Mapping[str, float], place: Place) -> Iterator[tuple[MotionEffect, Place, float]]:
    if any(values.values()):
        for part, (coefficient, *_) in cls.coefficients(values).items():
            if isinstance(part, MotionEffect):
                yield part, place, coefficient


def read_urdf_back(robot: Robot, reader: str, beside: Mapping[str, str] = MappingProxyType({})) -> ReadBack:
    """What a reader takes from the URDF that ``robot`` was read from, by pinocchio, and from the files ``beside``."""
    attributes = {**robot.described_dynamics, **_of_gazebo(robot), **_of_drake(robot)}
    for text in beside.values():
        armatures = {name: own.get("armature", 0.0) for name, own in json.loads(text).items()}
        attributes |= {(name, "joint/armature"): armature for name, armature in armatures.items()}
    return ReadBack(reader, {body.name: body.parameters for body in robot.bodies}, attributes)


def _of_gazebo(robot: Robot) -> Attributes:
    """Numbers in elements of ``<gazebo reference=JOINT>``."""
    elements = read_xml(robot.urdf, robot.source).findall("gazebo")
    named = [(element.get("reference", ""), child) for element in elements for child in element]
    return {(joint, f"gazebo/{child.tag}"): value for joint, child in named if (value := _number(child.text))}


def _of_drake(robot: Robot) -> Attributes:
    """Inertias of rotors, as they are behind their gears, at the actuators of transmissions."""
    found: Attributes = {}
    for transmission in read_xml(robot.urdf, robot.source).findall("transmission"):
        joint, actuator = transmission.find("joint"), transmission.find("actuator")
        said = {_local_name(child): _number(child.get("value")) for child in ([] if actuator is None else actuator)}
        ratio = said.pop("gear_ratio", 0.0) or 1.0
        if joint is not None:
            found |= {(joint.get("name", ""), f"actuator/drake:{name}"): own * ratio**2 for name, own in said.items()}
    return found


def _local_name(element: Element) -> str:
    """An element's name without its namespace."""
    return re.sub(r"^\{.*\}|^.*:", "", str(element.tag))


def _number(text: str | None) -> float:
    """A number, zero for what is none."""
    try:
        return float(text or 0.0)
    except ValueError:
        return 0.0


def read_mjcf_back(text: str, robot: Robot) -> ReadBack:
    """The bodies and joints of an MJCF of ``robot``, as MuJoCo has compiled them.

    Raises:
        InputError: MuJoCo is not installed, or does not take it.
    """
    mujoco = load_mujoco()
    try:
        model = mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        raise InputError(f"the written MJCF: MuJoCo does not take it ({error})") from error
    inertias: dict[str, FloatArray] = {}
    for index in range(1, model.nbody):
        name = model.body(index).name.removesuffix(_PAYLOAD)
        inertias[name] = inertias.get(name, np.zeros(10)) + _parameters(mujoco, model, index)
    attributes: Attributes = {}
    for name in robot.joint_names:
        joint = model.joint(name)
        (dof,), (place,) = joint.dofadr, joint.qposadr
        attributes[name, "joint/damping"] = float(model.dof_damping[dof])
        attributes[name, "joint/frictionloss"] = float(model.dof_frictionloss[dof])
        attributes[name, "joint/armature"] = float(model.dof_armature[dof])
        attributes[name, "joint/stiffness"] = float(joint.stiffness[0])
        attributes[name, "joint/springref"] = float(model.qpos_spring[place])
    for index in range(model.ntendon):
        first, second = model.wrap_objid[model.tendon_adr[index] :][:2]
        pair = pair_name(model.joint(first).name, model.joint(second).name)
        attributes[pair, "tendon/coef"] = float(model.wrap_prm[model.tendon_adr[index] + 1])
        for key in ("damping", "frictionloss", "armature"):
            place = pair, f"tendon/{key}"
            attributes[place] = attributes.get(place, 0.0) + float(np.ravel(getattr(model, f"tendon_{key}")[index])[0])
    own = {"world_link": "world"}
    return ReadBack("mujoco", {own.get(name, name): value for name, value in inertias.items()}, attributes)


def _parameters(mujoco: Any, model: Any, index: int) -> FloatArray:
    """Parameters ``(10,)`` of a body about its frame's origin."""
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.body_iquat[index])
    axes = rotation.reshape(3, 3)
    inertia = axes @ np.diag(model.body_inertia[index]) @ axes.T
    return pseudo_inertia.assemble(model.body_mass[index], model.body_ipos[index], inertia)


MUJOCO = "mujoco"


@dataclass(frozen=True, eq=False)
class HandedOver:
    """The file for a ``reader``.

    Attributes:
        session: the robot, and the description that was given.
        estimate: what was found.
        reader: of :data:`~geomid_ros.files.models.written_model.ELEMENTS`.
    """

    session: Session
    estimate: Estimate
    reader: str

    @property
    def name(self) -> str:
        """The file's name."""
        return file_name(self.reader)

    @cached_property
    def model(self) -> WrittenModel:
        """What is written."""
        return written_model(self.session.model, self.estimate, self.reader, self.session.loaded.effects)

    @cached_property
    def _whole(self) -> Whole:
        session = self.session
        urdf = with_inertias_of(session, self.estimate, self.model)
        robot = RobotToDescribe(
            urdf,
            Path(session.robot.source),
            self.model.effects,
            session.configuration.gravity,
            partial(session.read_robot, urdf, session.robot.source),
        )
        return DESCRIPTIONS[self.reader].whole(robot)

    @property
    def files(self) -> dict[str, str]:
        """Texts of the files by name: the description, and what stands beside it."""
        return {self.name: self._whole.text, **self._whole.beside}

    def judged(self, batches: Sequence[Samples], found: Mapping[str, float]) -> JudgedFile:
        """How well it predicts samples, of which all that was ``found`` leaves this RMS by channel. Raises InputError
        where the program does not take the file."""
        effects = model_effects(self.estimate, self.session.loaded.effects)
        lacks = {
            channel.name: unsaid(
                [own for own in effects if channel.name in own.joint.split("+")], ELEMENTS[self.reader]
            )
            for channel in self.session.model.channels
        }
        return judge(
            self.session, self.reader, self._whole, batches, found, errors=self._errors_of_sensors, lacks=lacks
        )

    @property
    def _errors_of_sensors(self) -> FloatArray:
        """Parameters ``(D,)`` of the errors of sensors that stand beside the file."""
        model = self.session.model
        of_sensors = [effect for effect in self.model.effects if effect_class(effect.effect).of_sensor]
        return np.concatenate([np.zeros(len(model.nominal_inertias)), coefficients_of(model, of_sensors)])


def file_name(reader: str) -> str:
    """The name of the file for a reader."""
    names = {URDF: "identified.urdf", "moveit": "identified.urdf", MUJOCO: "identified.xml"}
    return names.get(reader, f"identified.{reader}.urdf")


@dataclass(frozen=True, eq=False)
class JudgedFile:
    """What a file leaves of samples, RMS by channel [N m, N], NaN where nothing is measured.

    Attributes:
        name: the file.
        program: that loaded it.
        alone: of the file by itself.
        corrected: of the file, with the errors of sensors that stand beside it.
        given: of the description that it is from.
        found: of all that was found, also what the file cannot say.
        lacks: what the estimate has there and the file cannot say, in words; not of channels where that is not known.
    """

    name: str
    program: str
    alone: Mapping[str, float]
    corrected: Mapping[str, float]
    given: Mapping[str, float]
    found: Mapping[str, float]
    lacks: Mapping[str, Sequence[str]]

    @property
    def sentence(self) -> str:
        """How well it predicts beside the description that it is from, in sums over the channels."""
        own, given = (float(np.nansum(list(kind.values()))) for kind in (self.alone, self.given))
        return f"RMS of the residual, summed over the channels: {self.name} {own:.3g}, given description {given:.3g}"

    @property
    def worse(self) -> list[str]:
        """Sentences on the channels that it predicts worse than the description that it is from, and so does all that
        was found."""
        return [f"{said}; {_RECORD}" for name, said in self._worse if self._whatever_it_says(name)]

    @property
    def limited(self) -> list[str]:
        """The same where all that was found predicts better: what the file cannot say is why, or that the errors of
        sensors stand beside it."""
        return [f"{said}{self._why(name)}" for name, said in self._worse if not self._whatever_it_says(name)]

    @property
    def _worse(self) -> Iterator[tuple[str, str]]:
        for name, own in self.alone.items():
            if self._is_worse(name, own):
                sentence = (
                    f"'{name}' is predicted worse by {self.name} than by the given description: RMS {own:.3g} "
                    f"instead of {self.given[name]:.3g}"
                )
                yield name, sentence

    def _whatever_it_says(self, channel: str) -> bool:
        return all(self._is_worse(channel, kind[channel]) for kind in (self.corrected, self.found))

    def _is_worse(self, channel: str, left: float) -> bool:
        return left > WORSE * self.given[channel]

    def _why(self, channel: str) -> str:
        if not self._is_worse(channel, corrected := self.corrected[channel]):
            return f", {corrected:.3g} with the errors of sensors in effects.yaml; {_ADD}"
        lacks = self.lacks.get(channel)
        return (f" (it cannot hold {'; '.join(lacks)})" if lacks else "") + f"; {_ADVICE}"

    @property
    def entry(self) -> dict[str, object]:
        """As ``estimate.json`` has it."""
        return {"file": self.name, "loaded_by": self.program, **entry(self, "alone", "corrected", "given")}


_RECORD = (
    "so does the estimate: what was fitted does not carry over to this motion. Record more motion of this joint, in "
    "more poses of the others, and check that nothing was carried or touched meanwhile"
)
_ADD = "add these to what it predicts, or record more motion, as they may be weights"
_ADVICE = "choose another format (--for), or record more motion of this joint"


def judge(
    session: Session,
    reader: str,
    whole: Whole,
    batches: Sequence[Samples],
    found: Mapping[str, float],
    errors: FloatArray | None = None,
    lacks: Mapping[str, Sequence[str]] = MappingProxyType({}),
) -> JudgedFile:
    """How well a description predicts samples, loaded by the program that reads it.

    Args:
        session: the robot, and the description that was given.
        reader: who reads it.
        whole: the description.
        batches: samples to judge on.
        found: RMS of what all that was found leaves of them, by channel.
        errors: parameters ``(D,)`` of the errors of sensors that stand beside it.
        lacks: what the estimate has and the description cannot say, by channel.

    Raises:
        InputError: the program does not take it.
    """
    name, program = file_name(reader), "MuJoCo" if reader == MUJOCO else "pinocchio"
    if reader == MUJOCO:
        written = read_mjcf_back(whole.text, session.robot)
    else:
        written = read_urdf_back(session.read_robot(whole.text, name), reader, whole.beside)
    given = read_urdf_back(session.robot, URDF if reader == MUJOCO else reader)
    model, none = session.model, np.zeros(session.model.dimension)
    kinds = (written, none), (written, none if errors is None else errors), (given, none)
    parameters = np.column_stack([read.parameters(model) + beside for read, beside in kinds])

    def added(samples: Samples) -> FloatArray:
        return np.stack([read.efforts(model.robot.joint_names, samples) for read, _ in kinds], axis=2)

    channels = [channel.name for channel in model.channels]
    left = session.rms(batches, parameters, added).T.tolist()
    alone, corrected, before = (dict(zip(channels, own, strict=True)) for own in left)
    return JudgedFile(
        name=name, program=program, alone=alone, corrected=corrected, given=before, found=found, lacks=lacks
    )
