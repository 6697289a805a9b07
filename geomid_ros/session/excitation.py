"""From a robot description and what a user asks for to a motion that is feasible and tells much, or decides between
the names that a gap report leaves open.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.excitation.feasibility import Feasibility, Margins
from geomid_ros.excitation.knowledge import (
    PREDICTION,
    Belief,
    Learning,
    expected_learning,
    known_before,
    meaning_of,
    prior_knowledge,
    weight_of,
)
from geomid_ros.excitation.limits import MotionLimits, motion_limits, starts
from geomid_ros.excitation.motion import ExcitingMotion, MotionForm, Trajectory
from geomid_ros.excitation.rivals import (
    DECIDED,
    Ambiguity,
    DiscriminationCriterion,
    Name,
    coefficients_of,
    deciding_motion,
)
from geomid_ros.excitation.search import Search, expected_error, other_motions, random_feasible
from geomid_ros.files.models.effects_file import payload_parameters
from geomid_ros.files.models.estimate_file import EstimateFile
from geomid_ros.files.models.gap_file import OpenFinding, read_open_findings
from geomid_ros.files.models.posterior import beside, read_posterior
from geomid_ros.files.parameter_file import read_joint_limits
from geomid_ros.gap.candidates import Candidate
from geomid_ros.model.channels import is_wrench_channel
from geomid_ros.model.collision import CollisionModel, Pair
from geomid_ros.model.effects import Effect, KnownEffect, OnLink, Place, effect_class, values_of
from geomid_ros.model.measurement import MeasurementModel
from geomid_ros.session.collision_scene import NOT_LOOKED, collision_model, not_watched, without_touching
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.options import MotionOptions
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray, frozen

RATE = 100.0
"""[Hz] of the points of a trajectory."""
_OTHERS = 6  # motions on which efforts are to be predicted
_COMPARED = 3  # random motions with which a designed one is compared
_MANY = 20.0  # recordings
_SLOW_SHARE = {PREDICTION: 0.1, "friction": 0.5}


@dataclass(frozen=True, eq=False, kw_only=True)
class DesignTask:
    """A robot, its limits and surroundings, and what is known of it.

    Attributes:
        feasibility: what a motion must hold.
        knowledge: before the motion.
        form: of the motion.
        not_watched: pairs of links whose distance is not looked at.
        notes: what was settled for the user, in sentences.
    """

    feasibility: Feasibility
    knowledge: Belief
    form: MotionForm
    not_watched: tuple[Pair, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Decision:
    """By how much a name and its rival will differ (-2 log p, in the worse case of which is true): after the designed
    motion, and after a ``random`` one."""

    found: str
    rival: str
    difference: float
    random: float

    @property
    def is_sure(self) -> bool:
        """Whether the motion is expected to decide."""
        return self.difference >= DECIDED

    @property
    def sentence(self) -> str:
        """In words."""
        said = (
            f"{self.found} or {self.rival}: after this motion their scores differ by {self.difference:.3g} or more, "
            f"after a random one by {self.random:.3g}"
        )
        if self.is_sure:
            return f"{said}; {DECIDED:g} decide"
        times = DECIDED / max(self.difference, 1e-9)
        longer = (
            f"record it {times:.0f} times"
            if times < _MANY
            else "no motion within these limits discriminates between them"
        )
        return f"{said}; {DECIDED:g} would decide: {longer}"


@dataclass(frozen=True, eq=False, kw_only=True)
class Excitation:
    """A designed motion, with how far it stays from all limits, what it is expected to teach (of what the expected
    ``error`` is, in words), and which rivals it is expected to tell apart."""

    task: DesignTask
    error: str
    motion: ExcitingMotion
    margins: Margins
    learning: Learning
    decisions: tuple[Decision, ...] = ()

    @property
    def closest(self) -> str:
        """The pair that has the least to spare, in words; empty if nothing is watched."""
        collision, clearances = self.task.feasibility.collision, self.task.feasibility.clearances
        if collision is None or not collision.pairs:
            return ""
        place = int(np.argmin(self.margins.distance - clearances))
        lower, asked = 1e3 * self.margins.distance[place], 1e3 * clearances[place]
        half = ", half of their distance at the start" if clearances[place] < self.task.feasibility.clearance else ""
        return f"{collision.pairs[place]} stay at least {lower:.0f} mm apart (required: {asked:.0f} mm{half})"

    def not_worth(self, until: float) -> str:
        """Why a motion is not worth it that lowers the expected error by less than the share ``until``, in words."""
        gain, seconds = max(self.learning.gain, 0.0), self.motion.form.duration
        return f"{seconds:g} s more would lower the expected error by {gain:.1%}, less than {100.0 * until:g}%"

    @property
    def trajectory(self) -> Trajectory:
        """The motion as points."""
        duration = self.motion.form.duration
        times = np.linspace(0.0, duration, round(RATE * duration) + 1)
        return Trajectory(self.task.feasibility.names, times, *self.motion.at(times)[:3])


def task_of(urdf: str, source: Path, configuration: Configuration, wish: MotionOptions) -> DesignTask:
    """All that a search needs.

    Args:
        urdf: text of the robot description.
        source: its file, from where meshes are looked for.
        configuration: parameters; ``model`` says what is known already.
        wish: what is asked for.

    Raises:
        InputError: something is missing, or the robot cannot begin.
    """
    if known := str(configuration["model"]):
        beside(Path(known))  # a gap's estimate has none, and its identified.urdf has links that were not identified
    session = Session(urdf, configuration, str(source))
    robot, model = session.robot, _model_of(session)
    if robot.floating_base or not model.layout.efforts:
        raise InputError("motions are designed for arms on a fixed base whose joint efforts can be predicted")
    given = read_joint_limits(Path(wish.limits), robot.joint_names) if wish.limits else {}
    inertias = np.array([body.parameters for body in robot.bodies])
    limits = motion_limits(robot, given, inertias, wish.speed, str(source))
    knowledge = _knowledge(session, model, limits)
    collision = collision_model(wish, robot, source)
    feasibility, unwatched = _feasibility(knowledge, limits, collision, wish)
    notes = [*limits.notes, "" if collision else NOT_LOOKED, not_watched(unwatched), *robot.repaired.values()]
    slow = _SLOW_SHARE.get(wish.aim, _SLOW_SHARE[PREDICTION])
    form = MotionForm(period=wish.duration / wish.repeats, slow_share=slow, repeats=wish.repeats)
    return DesignTask(
        feasibility=feasibility,
        knowledge=knowledge,
        form=form,
        not_watched=unwatched,
        notes=tuple(filter(None, notes)),
    )


def _model_of(session: Session) -> MeasurementModel:
    """The session's model with the effects that every place has, or that an earlier estimate found."""
    model = session.model
    if session.loaded.source:
        known = read_posterior(beside(Path(session.loaded.source)))
        found = {(effect.name, effect.place, effect.parameter, effect.positive) for effect in known.effects}
        said = session.loaded.in_its_shape(model)
        chosen = [
            index
            for index, (c, is_said) in enumerate(zip(model.coefficients, said.tolist(), strict=True))
            if is_said and (c.effect.name, c.place_name, c.parameter, c.positive) in found
        ]
        return model.with_coefficients(chosen)
    return model.with_coefficients([index for index, c in enumerate(model.coefficients) if not c.optional])


def _knowledge(session: Session, model: MeasurementModel, limits: MotionLimits) -> Belief:
    prior = prior_knowledge(model, limits)
    if not session.loaded.source:
        return prior
    measured = EstimateFile.read(Path(session.loaded.source)).sigma
    sigmas = [measured.get(channel.name) for channel in model.channels]
    own = [
        sigma if sigma and math.isfinite(sigma) else usual
        for sigma, usual in zip(sigmas, prior.sigmas.tolist(), strict=True)
    ]
    return known_before(model, read_posterior(beside(Path(session.loaded.source))), own, session.loaded.source)


def _feasibility(
    knowledge: Belief, limits: MotionLimits, collision: CollisionModel | None, wish: MotionOptions
) -> tuple[Feasibility, tuple[Pair, ...]]:
    """The first of the starts that can be begun from, and the pairs that are left out."""
    names = knowledge.model.robot.joint_names
    if len(wish.start) not in (0, len(names)):
        raise InputError(
            f"--start has {len(wish.start)} numbers, expected {len(names)}: those of {', '.join(names)} [rad, m]"
        )
    tried = [np.array(wish.start)] if wish.start else list(starts(limits))
    unwatched = without_touching(collision, tried[0]) if collision is not None else ()
    refused = []
    for start in tried:
        try:
            return Feasibility(knowledge, limits, start, collision, wish.clearance), unwatched
        except InputError as error:
            refused.append(error)
    if wish.start:
        raise refused[0]
    raise InputError(_nowhere(refused, room=bool(wish.avoid)))


def _nowhere(refused: Sequence[InputError], *, room: bool) -> str:
    """Why no posture can be begun from, and what to give; ``room``: obstacles may take it."""
    said = f"no feasible start was found among {len(refused)} postures; the first one: {refused[0]}"
    if not room:
        return said
    return f"{said}, or make room: --avoid is in metres in the base frame, each part of a mesh is its convex hull"


def design(task: DesignTask, wish: MotionOptions) -> Excitation:
    """Search for a motion and say what to expect of it."""
    random, feasibility = np.random.default_rng(wish.seed), task.feasibility
    judge, labels = (None, []) if wish.settle is None else open_questions(task.feasibility, Path(wish.settle))
    others = other_motions(feasibility, task.form, random, _OTHERS)
    weight = weight_of(wish.aim, task.knowledge, others)
    criterion = expected_error(feasibility, weight, task.form)
    searching = partial(wish.progress, "searching")
    if judge is None:
        motion = Search(feasibility, task.form, criterion).run(random, searching)
    else:
        motion = deciding_motion(feasibility, task.form, judge, random, searching)
    wish.progress("comparing", 0.0)
    randoms = [random_feasible(feasibility, task.form, random) for _ in range(_COMPARED)]
    learning = expected_learning(task.knowledge, weight, motion, randoms)
    decisions = () if judge is None else tuple(_decisions(judge, labels, motion, randoms))
    return Excitation(
        task=task,
        error=meaning_of(wish.aim),
        motion=motion,
        margins=feasibility.margins(motion),
        learning=learning,
        decisions=decisions,
    )


def _decisions(
    judge: DiscriminationCriterion,
    labels: Sequence[tuple[str, Sequence[str]]],
    motion: ExcitingMotion,
    randoms: Sequence[ExcitingMotion],
) -> Iterator[Decision]:
    own, others = judge.differences(motion), [judge.differences(random) for random in randoms]
    for place, (found, rivals) in enumerate(labels):
        for index, rival in enumerate(rivals):
            yield Decision(found, rival, own[place][index], float(np.median([o[place][index] for o in others])))


def open_questions(feasibility: Feasibility, path: Path) -> tuple[DiscriminationCriterion, list[tuple[str, list[str]]]]:
    """Who says what a motion would decide, and of each finding its label and those of its rivals.

    Raises InputError naming the ``path`` of the gap.json, and what does not fit the robot.
    """
    findings, floor = read_open_findings(path)
    before = feasibility.knowledge
    model = before.model.without_effects()
    _refuse_others(model, floor, path)
    knowledge = prior_knowledge(model, feasibility.limits)
    names = [channel.name for channel in model.channels]
    sigmas = [floor.get(name) or own for name, own in zip(names, knowledge.sigmas.tolist(), strict=True)]
    knowledge = replace(knowledge, sigmas=frozen(sigmas))
    disputes = [_dispute(model, finding) for finding in findings]
    labels = [(dispute.found.label, [rival.label for rival in dispute.rivals]) for dispute in disputes]
    return DiscriminationCriterion(knowledge, disputes), labels


def _refuse_others(model: MeasurementModel, floor: Mapping[str, float], path: Path) -> None:
    """Raise InputError where a gap report says something of joints that the robot does not have."""
    joints = [joint.name for joint in model.robot.tree.joints if joint.type != "fixed"]
    for name in floor:
        if name not in joints and not is_wrench_channel(name):
            raise InputError(f"{path}: was written for another robot: {unknown_name('joint', name, joints)}")


def _dispute(model: MeasurementModel, entry: OpenFinding) -> Ambiguity:
    found = _name_of_finding(model, entry)
    rivals = [_any(model, rival.effect, rival.joint) for rival in entry.rivals]
    return Ambiguity(found, _coefficients(entry, found), tuple(rivals))


def _name_of_finding(model: MeasurementModel, finding: KnownEffect) -> Name:
    """The found effect with its constants first."""
    any_of = _any(model, finding.effect, finding.joint, finding.link)
    if isinstance(any_of.place, OnLink):
        return any_of
    own = effect_class(finding.effect).from_values(values_of(finding))
    return replace(any_of, variants=(own, *(variant for variant in any_of.variants if variant != own)))


def _any(model: MeasurementModel, effect: str, joint: str, link: str = "") -> Name:
    """An effect with any of its constants, at the place that files call ``joint``."""
    cls = effect_class(effect)
    variants = cls.variants()
    places = {model.places.link(place) or model.places.name(place): place for place in model.places.of(variants[0])}
    place = places[link] if link in places else model.places.named(variants[0], joint)
    where = link or joint
    label = f"{cls.label} at {where}" if where else cls.label
    return Name(variants, place, label, _penalty(variants[0], place))


def _penalty(effect: Effect, place: Place) -> float:
    """For how many parameters an effect counts: a body for those that are said first, without its inertia."""
    terms = Candidate.of(effect, place).terms
    return float(len(terms) + bool(effect.scanned)) if terms else float(effect.said_first or 0)


def _coefficients(finding: KnownEffect, found: Name) -> FloatArray:
    values = values_of(finding)
    if isinstance(found.place, OnLink):
        return payload_parameters(values)
    return coefficients_of(effect_class(finding.effect), values, found.variants[0].parts)
