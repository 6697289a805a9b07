"""Handover of a robot description: written, loaded again by MuJoCo or pinocchio, and tested in that form."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import TypeAlias

import numpy as np

from geomid_ros.checks.unexplained import WORSE
from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import Estimate, UncertainInertia
from geomid_ros.exports.descriptions import DESCRIPTIONS, DescriptionFiles, RobotToDescribe
from geomid_ros.files.models.effects_file import coefficients_of, effect_name, unrepresentable, with_places
from geomid_ros.files.models.estimate_file import model_effects
from geomid_ros.files.models.readers import DESCRIBED_FOR, ELEMENTS, MUJOCO, URDF
from geomid_ros.files.models.written_model import WrittenModel, written_model
from geomid_ros.files.schema import attributes_entry
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.effects import EFFECTS, Effect, KnownEffect, MotionEffect, Place
from geomid_ros.model.effects.situation import pair_name, place_named
from geomid_ros.model.measurement_model import MeasurementModel, slides
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.model.urdf_tree import read_xml
from geomid_ros.resimulation.written_robot import body_inertias, joint_attributes, load_mujoco
from geomid_ros.session.session import Session, with_inertias_of
from geomid_ros.types import FloatArray

Attributes: TypeAlias = dict[tuple[str, str], float]
"""Numbers of a description by joint and ``ELEMENT/ATTRIBUTE``."""


@dataclass(frozen=True, eq=False)
class ReadBack:
    """Values that a ``reader`` takes from a description: ``inertias (10,)`` by body, and ``attributes`` of joints; and
    ``gravity (3,)`` in the base frame, if it states one [m/s^2]."""

    reader: str
    inertias: Mapping[str, FloatArray]
    attributes: Attributes
    gravity: FloatArray | None = None

    def parameters(self, model: MeasurementModel) -> FloatArray:
        """Parameters ``(D,)`` of ``model`` with these inertias and no effects."""
        bodies = [self.inertias[name] for name in model.body_names]
        return np.concatenate([*bodies, np.zeros(len(model.coefficients))])

    def efforts(self, robot: Robot, samples: Samples) -> FloatArray:
        """Joint efforts ``(N, joints)`` due to the attributes, and to another gravity than the ``robot``'s."""
        efforts = samples.efforts_of(self._terms(robot))
        if self.gravity is None:
            return efforts
        bodies = np.array([self.inertias[name] for name in robot.body_names])
        model = robot.with_inertias(bodies, range(len(bodies)))
        change = (self.gravity - robot.gravity)[:, None]
        by_gravity = robot.efforts_by_gravity(model, model.createData(), robot.configuration(samples)[0], change)
        return efforts + by_gravity[:, :, 0]

    def _terms(self, robot: Robot) -> Iterator[tuple[MotionEffect, Place, float]]:
        """Yield the effects that the attributes stand for, with their places and coefficients, in the shape of
        :attr:`MeasurementModel.described_shapes`."""
        used, joints = set[str](), robot.joint_names
        for cls in (effect for effect in EFFECTS.values() if issubclass(effect, MotionEffect)):
            places = {form.name: form.place_in(ELEMENTS[self.reader]) for form in cls.parameters}
            sizes = {places[form.name] for form in cls.grid()[0].column_parameters if places[form.name]}
            if not used & sizes:
                used |= sizes
                for name in {name for name, at in self.attributes if at in sizes}:
                    values = {key: self.attributes.get((name, place), 0.0) for key, place in places.items()}
                    where = place_named(cls.place, name, joints)
                    if where is not None and any(values.values()):
                        yield from _parts(cls, values, where, sharp=slides(robot, where))


def _parts(
    cls: type[Effect], values: Mapping[str, float], place: Place, *, sharp: bool
) -> Iterator[tuple[MotionEffect, Place, float]]:
    name = cls.default_constant
    shape = {name: getattr(cls.grid()[0], name)} if name and sharp else {}
    for part, (coefficient, *_) in cls.coefficients({**values, **shape}).items():
        if isinstance(part, MotionEffect):
            yield part, place, coefficient


def read_urdf_back(robot: Robot, reader: str, beside: Mapping[str, str] = MappingProxyType({})) -> ReadBack:
    """Return the values read from the URDF of ``robot``, by pinocchio, and from the files ``beside`` it."""
    attributes = {**robot.described_dynamics, **_of_gazebo(robot), **_of_drake(robot)}
    for text in beside.values():
        armatures = {name: values.get("armature", 0.0) for name, values in json.loads(text).items()}
        attributes |= {(name, "joint/armature"): armature for name, armature in armatures.items()}
    return ReadBack(reader, {body.name: body.parameters for body in robot.bodies}, attributes)


def _of_gazebo(robot: Robot) -> Attributes:
    """Return the numbers in elements of ``<gazebo reference=JOINT>``."""
    elements = read_xml(robot.urdf, robot.source).findall("gazebo")
    children = [(element.get("reference", ""), child) for element in elements for child in element]
    return {(joint, f"gazebo/{child.tag}"): value for joint, child in children if (value := _number(child.text))}


def _of_drake(robot: Robot) -> Attributes:
    """Return rotor inertias, reflected through their gears, from the actuators of transmissions."""
    rotor: Attributes = {}
    for transmission in read_xml(robot.urdf, robot.source).findall("transmission"):
        joint, actuator = transmission.find("joint"), transmission.find("actuator")
        children = [] if actuator is None else list(actuator)
        raws = {child.tag.rpartition("}")[2]: _number(child.get("value")) for child in children}
        ratio = raws.pop("gear_ratio", 0.0) or 1.0
        if joint is not None:
            rotor |= {(joint.get("name", ""), f"actuator/drake:{name}"): raw * ratio**2 for name, raw in raws.items()}
    return rotor


def _number(text: str | None) -> float:
    """Parse a number; zero if it is none."""
    try:
        return float(text or 0.0)
    except ValueError:
        return 0.0


def read_mjcf_back(text: str, robot: Robot) -> ReadBack:
    """Return the bodies and joints of an MJCF of ``robot``, as compiled by MuJoCo.

    Raises:
        InputError: MuJoCo is not installed, or rejects the file.
    """
    mujoco = load_mujoco()
    try:
        model = mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        raise InputError(f"the written MJCF: MuJoCo does not take it ({error})") from error
    inertias = dict.fromkeys(robot.body_names, np.zeros(10))
    for name, parameters in body_inertias(model).items():
        link = {"world_link": "world"}.get(name, name.removesuffix("/payload"))
        if (body := robot.body_of(link)) is not None:
            placed = robot.fixed_placement(link, body)
            inertias[body] = inertias[body] + pseudo_inertia.moved(parameters, placed)
    attributes: Attributes = {}
    for name in robot.joint_names:
        attributes |= {(name, f"joint/{key}"): value for key, value in joint_attributes(model, name).items()}
    for index in range(model.ntendon):
        first, second = model.wrap_objid[model.tendon_adr[index] :][:2]
        pair = pair_name(model.joint(first).name, model.joint(second).name)
        attributes[pair, "tendon/coef"] = float(model.wrap_prm[model.tendon_adr[index] + 1])
        for key in ("damping", "frictionloss", "armature"):
            place = pair, f"tendon/{key}"
            attributes[place] = attributes.get(place, 0.0) + float(np.ravel(getattr(model, f"tendon_{key}")[index])[0])
    return ReadBack("mujoco", inertias, attributes, np.array(model.opt.gravity))


@dataclass(frozen=True, eq=False)
class DescriptionTest:
    """Description file for a ``reader``.

    Attributes:
        session: the robot, and the description that was given.
        estimate: the estimate to write.
        reader: of :data:`~geomid_ros.files.models.readers.ELEMENTS`.
    """

    session: Session
    estimate: Estimate
    reader: str

    @property
    def name(self) -> str:
        """Name of the file."""
        return file_name(self.reader)

    @cached_property
    def model(self) -> WrittenModel:
        """Model that is written."""
        return written_model(self.session.model, self.estimate, self.reader, self.session.loaded.effects)

    @cached_property
    def _whole(self) -> DescriptionFiles:
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
    def omissions(self) -> list[str]:
        """Sentences on what the file omits or its reader ignores: shapes of an MJCF, for example."""
        return [f"{self.name}: {sentence}" for sentence in self._whole.omissions]

    @property
    def files(self) -> dict[str, str]:
        """Texts of the files by name: the description, and the files beside it."""
        return {self.name: self._whole.text, **self._whole.extra_files}

    def evaluate(self, batches: Sequence[Samples], full_rms: Mapping[str, float]) -> FileTest:
        """Test the file on samples. ``full_rms``: residual RMS of the full estimate on them, by channel. Raises
        InputError if MuJoCo or pinocchio rejects it."""
        return evaluate_description(
            self.session,
            self.reader,
            self._whole,
            batches,
            full_rms,
            effects=model_effects(self.estimate, self.session.loaded.effects),
            beside=self.model.effects,
            links={link.name: link for link in self.estimate.links},
        )


def _fuller(effects: Sequence[KnownEffect], reader: str) -> tuple[str, ...]:
    """Readers of the formats that can represent most of the effects, if that is more than this ``reader``'s can."""
    lacking = {
        each: sum(bool(unrepresentable([effect], ELEMENTS[each])) for effect in effects) for each in DESCRIBED_FOR
    }
    return tuple(each for each, count in lacking.items() if min(lacking.values()) == count < lacking[reader])


def _added(read: ReadBack, effects: Iterable[KnownEffect], joints: Sequence[str]) -> tuple[str, ...]:
    """Effects in words that a description has at ``joints`` and the ``effects`` have not: its own fit chose them, or
    they are of the given description."""
    elements = ELEMENTS[read.reader]
    own = {(e.joint, form.place_in(elements)) for e in effects for form in e.cls.parameters}
    kinds = {cls.parameters[0].place_in(elements): cls for cls in reversed(EFFECTS.values())}
    added = [pair for pair, value in read.attributes.items() if value and pair[1] in kinds and pair not in own]
    moving = [pair for pair in added if place_named(kinds[pair[1]].place, pair[0], joints) is not None]
    return tuple(with_places((effect_name(kinds[at].name), joint) for joint, at in moving))


def _bent(read: ReadBack, links: Mapping[str, UncertainInertia]) -> tuple[str, ...]:
    """Links in words whose mass in a description is outside of its 95 % interval: they stand in for what it lacks."""
    masses = {name: (float(read.inertias[name][0]), *link.mass_interval) for name, link in links.items()}
    outside = {name: numbers for name, numbers in masses.items() if not numbers[1] <= numbers[0] <= numbers[2]}
    return tuple(f"'{n}' {own:.3g} kg (identified: {low:.3g} to {high:.3g})" for n, (own, low, high) in outside.items())


def file_name(reader: str) -> str:
    """Return the name of the file for a reader."""
    names = {URDF: "identified.urdf", "moveit": "identified.urdf", MUJOCO: "identified.xml"}
    return names.get(reader, f"identified.{reader}.urdf")


@dataclass(frozen=True, eq=False)
class FileTest:
    """Residual RMS of a file on samples by channel [N m, N], NaN where nothing is measured.

    Attributes:
        name: the file.
        program: the program that loaded it.
        alone: of the file by itself.
        corrected: of the file, with the sensor errors from the files beside it.
        given: of the given description.
        full_rms: of the full estimate, including effects that the file cannot represent.
        omissions: effects of the estimate that the file cannot represent, in words.
        added: effects of the file that the estimate has not, in words.
        bent: links of the file whose masses are not the estimate's, in words.
        fuller: readers of the formats that can represent most of them, if these can represent more.
        fuller_file: file beside it that is in such a format; empty if there is none.
    """

    name: str
    program: str
    alone: Mapping[str, float]
    corrected: Mapping[str, float]
    given: Mapping[str, float]
    full_rms: Mapping[str, float]
    omissions: Sequence[str] = ()
    added: Sequence[str] = ()
    bent: Sequence[str] = ()
    fuller: Sequence[str] = ()
    fuller_file: str = ""

    @property
    def sentence(self) -> str:
        """Residual RMS of the file and of the given description, each summed over the channels."""
        rms, given = (float(np.nansum(list(kind.values()))) for kind in (self.alone, self.given))
        return f"RMS of the residual, summed over the channels: {self.name} {rms:.3g}, given description {given:.3g}"

    @property
    def worse(self) -> list[str]:
        """Sentence on the channels that the file predicts worse than the given description, where the corrected file
        and the full estimate do, too; none without such channels."""
        names = self._degraded[_FIT]
        return [f"{self._worse_at(names)}, and by the full estimate, too: {_RECORD}"] if names else []

    @property
    def limited(self) -> list[str]:
        """Sentences on what the file lacks: effects, if it lost most of what the estimate gained or if channels are
        worse that the estimate predicts better; and sensor errors, which are beside the file."""
        lost, offsets = self._lost, self._degraded[_OFFSETS]
        return [
            *([f"{': '.join(filter(None, [lost, self._differs]))}; {self._advice}"] if lost else []),
            *([f"{self._worse_at(offsets)}, but not with {_ADD}"] if offsets else []),
        ]

    @property
    def note(self) -> str:
        """Sentence on what the file lacks or has instead; empty if there is nothing, or if :attr:`limited` has it."""
        if self._lost or not self._differs:
            return ""
        return f"{self.name}: {self._differs}{'; estimate.json has them' * bool(self.omissions)}"

    @property
    def _lost(self) -> str:
        """Clause on what the file predicts less well than the estimate, for what it cannot represent: with the sensor
        errors it is nearer to the given description, by the ratios of their RMS; or channels are worse than by that."""
        kinds = self.corrected, self.full_rms, self.given
        file, estimate, given = (float(np.nansum(list(kind.values()))) for kind in kinds)
        worse = self._worse_at(self._degraded[_FORMAT]) if self._degraded[_FORMAT] else ""
        if estimate < given and file**2 > estimate * given:
            left = f"{self.name} leaves {100 * file / given:.0f} % of the given description's error, the estimate "
            return f"{left}{100 * estimate / given:.0f} %{'; ' * bool(worse)}{worse}"
        return worse

    @property
    def _differs(self) -> str:
        """Clause on what the file has that the estimate has not, and the reverse; empty if there is nothing."""
        lists = {"adds": self.added, "cannot represent": self.omissions, "has other masses instead:": self.bent}
        clauses = [f"{verb} {', '.join(names)}" for verb, names in lists.items() if names]
        return f"the file {' and '.join(clauses)}" if clauses else ""

    @property
    def _advice(self) -> str:
        """Advice against a format that lacks effects."""
        fuller = self.fuller_file or f"--for {' or '.join(self.fuller)}"
        return f"{fuller} holds more of them" if self.fuller else _NO_FORMAT

    @property
    def _degraded(self) -> dict[str, list[str]]:
        """Channels that the file predicts worse than the given description, by the reason."""
        channels: dict[str, list[str]] = {_OFFSETS: [], _FIT: [], _FORMAT: []}
        for name, rms in self.alone.items():
            limit = WORSE * self.given[name]
            if rms > limit:
                estimate = _FIT if self.full_rms[name] > limit else _FORMAT
                channels[estimate if self.corrected[name] > limit else _OFFSETS].append(name)
        return channels

    def _worse_at(self, names: Sequence[str]) -> str:
        """Clause on the ``names`` of channels that the file predicts worse than the given description."""
        numbers = (f"'{name}' (RMS {self.alone[name]:.3g} instead of {self.given[name]:.3g})" for name in names)
        return f"{self.name} predicts {', '.join(numbers)} worse than the given description"

    @property
    def entry(self) -> dict[str, object]:
        """Entry of ``estimate.json``."""
        return {"file": self.name, "loaded_by": self.program, **attributes_entry(self, *_OF_ENTRY)}


_OF_ENTRY = ("alone", "corrected", "given", "omissions", "added", "bent")
_OFFSETS, _FIT, _FORMAT = "offsets", "fit", "format"
_RECORD = (
    "the fit does not generalise to this motion. Record more motion there, in more poses, and check that there was no "
    "payload or undeclared contact"
)
_ADD = (
    "the sensor errors of effects.yaml: add these to its predictions, or record more motion, as they may be due to "
    "masses instead"
)
_NO_FORMAT = "no format holds more; where that matters, use estimate.json"


def evaluate_description(
    session: Session,
    reader: str,
    description: DescriptionFiles,
    batches: Sequence[Samples],
    full_rms: Mapping[str, float],
    effects: Sequence[KnownEffect],
    beside: Sequence[KnownEffect] = (),
    links: Mapping[str, UncertainInertia] = MappingProxyType({}),
) -> FileTest:
    """Test a description on samples, loaded by MuJoCo if it is an MJCF, else by pinocchio.

    Args:
        session: the robot, and the description that was given.
        reader: the reader of the description.
        description: the description.
        batches: samples to test on.
        full_rms: residual RMS of the full estimate on them, by channel.
        effects: effects of the full estimate.
        beside: effects of the model that is written; its sensor errors are in a file beside the description.
        links: links of the full estimate, by name.

    Raises:
        InputError: MuJoCo or pinocchio rejects the description.
    """
    name, program = file_name(reader), "MuJoCo" if reader == MUJOCO else "pinocchio"
    if reader == MUJOCO:
        written = read_mjcf_back(description.text, session.robot)
    else:
        written = read_urdf_back(session.read_robot(description.text, name), reader, description.extra_files)
    given = read_urdf_back(session.robot, URDF if reader == MUJOCO else reader)
    model = session.model
    of_sensors = [effect for effect in beside if effect.cls.is_sensor_error]
    errors = np.concatenate([np.zeros(len(model.nominal_inertias)), coefficients_of(model, of_sensors)])
    kinds = ((written, 0.0), (written, errors), (given, 0.0))
    parameters = np.column_stack([read.parameters(model) + offsets for read, offsets in kinds])

    def added(samples: Samples) -> FloatArray:
        return np.stack([read.efforts(model.robot, samples) for read, _ in kinds], axis=2)

    channels = [channel.name for channel in model.channels]
    rms = session.rms(batches, parameters, added=added).T.tolist()
    alone, corrected, before = (dict(zip(channels, values, strict=True)) for values in rms)
    return FileTest(
        name=name,
        program=program,
        alone=alone,
        corrected=corrected,
        given=before,
        full_rms=full_rms,
        omissions=tuple(unrepresentable(effects, ELEMENTS[reader])),
        added=_added(written, effects, model.robot.joint_names),
        bent=_bent(written, links),
        fuller=_fuller(effects, reader),
    )
