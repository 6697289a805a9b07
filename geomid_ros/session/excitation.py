"""From a robot description and a user's request to a feasible motion that is informative, or that discriminates between
the rival effects of a gap report; the convex shapes that must not touch: a robot's and the user's obstacles."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from geomid_ros.errors import InputError, unknown_name
from geomid_ros.estimation.posterior import Posterior
from geomid_ros.excitation.belief import (
    PREDICTION,
    Belief,
    DesignComparison,
    aim_weight,
    belief_from_estimate,
    belief_from_urdf,
    error_description,
    expected_learning,
)
from geomid_ros.excitation.feasibility import Feasibility, Margins
from geomid_ros.excitation.limits import MotionLimits, motion_limits, start_postures
from geomid_ros.excitation.motion import ExcitingMotion, MotionForm, Trajectory
from geomid_ros.excitation.rivals import (
    DECIDED,
    Ambiguity,
    DiscriminationCriterion,
    NamedEffect,
    coefficients_of,
    discriminating_motion,
)
from geomid_ros.excitation.search import Search, expected_error, random_feasible, typical_motions
from geomid_ros.files.models.estimate_file import EstimateFile
from geomid_ros.files.models.gap_file import OpenFinding, read_open_findings
from geomid_ros.files.models.posterior import posterior_path, read_posterior
from geomid_ros.files.parameter_file import read_joint_limits
from geomid_ros.files.shapes import SUFFIXES, ShapeReader, read_mesh
from geomid_ros.inference.candidates import Candidate
from geomid_ros.model.channels import is_wrench_channel
from geomid_ros.model.collision import CollisionModel, ConvexShape, HalfSpace, Obstacle, Pair
from geomid_ros.model.effects import OnLink, effect_class
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.urdf_tree import read_xml
from geomid_ros.options import numbers_in
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.options import MotionOptions, Surroundings, texts
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray, frozen

_NOT_CHECKED = "collisions are not looked for (--no-collision): watch the robot"
_FORMS = "box:X,Y,Z,LENGTH,WIDTH,HEIGHT, plane:NX,NY,NZ,OFFSET or a mesh file, in metres in the base frame"
_NEIGHBOURS = 2  # joints between links whose hulls may overlap all the time


def collision_model(around: Surroundings, robot: Robot, source: Path) -> CollisionModel | None:
    """Collision model of a robot, whose URDF is from the file ``source``, and the obstacles; None if not requested.

    Raises InputError: the URDF has no shapes, or one cannot be read.
    """
    if not around.collision:
        if around.avoid:
            raise InputError("--avoid and --no-collision exclude each other")
        return None
    avoided = [obstacle for text in texts(around.avoid) for obstacle in obstacles(text)]
    return CollisionModel(robot, link_shapes(robot.urdf, source, around.package_path or {}), avoided)


def without_touching(collision: CollisionModel | None, start: FloatArray) -> tuple[Pair, ...]:
    """Exclude pairs of links that overlap at the start ``(J,)`` of a motion and are at most two joints apart, as their
    hulls are too coarse. Returns these pairs."""
    if collision is None:
        return ()
    touching = collision.distances(start[None])[0] <= 0.0
    touching &= np.count_nonzero(collision.reach, axis=1) <= _NEIGHBOURS
    touching &= np.array([not pair.is_obstacle for pair in collision.pairs], dtype=bool)
    pairs = tuple(collision.pairs[place] for place in np.flatnonzero(touching))
    collision.without(np.flatnonzero(touching))
    return tuple(dict.fromkeys(pairs))


def not_watched(collision: CollisionModel | None, excluded: Sequence[Pair]) -> list[str]:
    """Sentences on what is not checked: everything, or the ``excluded`` pairs."""
    if collision is None:
        return [_NOT_CHECKED]
    listing = "; ".join(map(str, excluded))
    return [f"not watched, as their convex hulls overlap at the start already: {listing}"] if listing else []


def link_shapes(urdf: str, path: Path, packages: Mapping[str, Path]) -> dict[str, list[ConvexShape]]:
    """Convex hulls of the shapes of a URDF's links, by link.

    Args:
        urdf: text of the URDF.
        path: its file, from which meshes are searched.
        packages: folders by package name, see :class:`~geomid_ros.files.models.urdf.MeshFinder`.

    Raises:
        InputError: a mesh cannot be read, or no link has a shape.
    """
    reader = ShapeReader(path, packages)
    outlines = {link.get("name", ""): reader.outlines(link) for link in read_xml(urdf, str(path)).findall("link")}
    hulls = {name: [ConvexShape(name, vertices) for vertices in shapes] for name, shapes in outlines.items() if shapes}
    if not hulls:
        raise InputError(
            f"{path}: no link has a <collision> or <visual> shape to check for collisions; add shapes, or "
            "give --no-collision if nothing can collide"
        )
    return hulls


def obstacles(text: str) -> list[Obstacle]:
    """Parse one ``--avoid``: a box about its centre, the half-space below a plane (points with ``n . x`` up to the
    offset), or a mesh, each of whose connected parts becomes its convex hull.

    Raises InputError naming it.
    """
    kind, _, rest = text.partition(":")
    if kind == "box":
        numbers = _numbers(rest, 6, text)
        if np.any(numbers[3:] <= 0.0):
            raise InputError(f"--avoid {text}: a box needs edges greater than zero")
        corners = np.array(np.meshgrid(*3 * [(-0.5, 0.5)])).reshape(3, -1).T
        return [ConvexShape(text, numbers[:3] + corners * numbers[3:])]
    if kind == "plane":
        numbers = _numbers(rest, 4, text)
        length = float(np.linalg.norm(numbers[:3]))
        if length == 0.0:
            raise InputError(f"--avoid {text}: the normal of the plane is zero")
        return [HalfSpace(text, numbers[:3] / length, float(numbers[3]) / length)]
    path = Path(text)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"--avoid {text}: expected {_FORMS}")
    mesh, _ = read_mesh(path, f"--avoid {text}")
    parts = list(mesh.split(only_watertight=True)) or [mesh]
    return [ConvexShape(text, np.asarray(part.vertices)) for part in parts]


def _numbers(text: str, count: int, obstacle: str) -> np.ndarray:
    numbers = numbers_in(text)
    if len(numbers) != count:
        raise InputError(f"--avoid {obstacle}: expected {count} finite numbers, as {_FORMS}")
    return np.array(numbers)


RATE = 100.0
"""Rate of the points of a trajectory [Hz]."""
_OTHERS = 6  # number of other motions whose efforts are to be predicted
_COMPARED = 3  # number of random motions to compare a designed one with
_MANY = 20.0  # recordings; a motion that needs as many does not discriminate
_SLOW_SHARE = {PREDICTION: 0.1, "friction": 0.5}


@dataclass(frozen=True, eq=False, kw_only=True)
class DesignTask:
    """A robot, its limits and obstacles, and the belief before a motion.

    Attributes:
        feasibility: constraints on a motion.
        belief: belief before the motion.
        form: form of the motion.
        excluded_pairs: pairs of links whose distance is not checked.
        notes: choices made for the user, in sentences.
    """

    feasibility: Feasibility
    belief: Belief
    form: MotionForm
    excluded_pairs: tuple[Pair, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class ExpectedDiscrimination:
    """Expected difference of the scores (-2 log p) of an effect and its rival, at least, whichever of the two
    is true: after the designed motion and after a ``random`` one."""

    found: str
    rival: str
    difference: float
    random: float

    @property
    def is_sure(self) -> bool:
        """True if the motion is expected to discriminate."""
        return self.difference >= DECIDED

    @property
    def sentence(self) -> str:
        """The expected discrimination in words."""
        summary = (
            f"{self.found} or {self.rival}: after this motion their scores differ by {self.difference:.3g} or more, "
            f"after a random one by {self.random:.3g}"
        )
        if self.is_sure:
            return f"{summary}; {DECIDED:g} decide"
        times = DECIDED / max(self.difference, 1e-9)
        hopeless = "no motion within these limits discriminates between them"
        advice = f"record it {times:.0f} times" if times < _MANY else hopeless
        return f"{summary}; {DECIDED:g} would decide: {advice}"


@dataclass(frozen=True, eq=False, kw_only=True)
class Excitation:
    """A designed motion, its margins to all limits, and its expected learning and discrimination of rivals; ``error``
    describes in words which expected error is reduced."""

    task: DesignTask
    error: str
    motion: ExcitingMotion
    margins: Margins
    learning: DesignComparison
    decisions: tuple[ExpectedDiscrimination, ...] = ()

    @property
    def closest(self) -> str:
        """Pair with the smallest margin to its required distance, in words; empty if no pair is watched."""
        collision, clearances = self.task.feasibility.collision, self.task.feasibility.clearances
        if collision is None or not collision.pairs:
            return ""
        place = int(np.argmin(self.margins.distance - clearances))
        lower, required = 1e3 * self.margins.distance[place], 1e3 * clearances[place]
        half = ", half of their distance at the start" if clearances[place] < self.task.feasibility.clearance else ""
        return f"{collision.pairs[place]} stay at least {lower:.0f} mm apart (required: {required:.0f} mm{half})"

    def not_worth(self, until: float) -> str:
        """Sentence: a motion is not worthwhile, as it lowers the expected error by less than the fraction ``until``."""
        gain, seconds = max(self.learning.gain, 0.0), self.motion.form.duration
        return f"{seconds:g} s more would lower the expected error by {gain:.1%}, less than {100.0 * until:g}%"

    @property
    def trajectory(self) -> Trajectory:
        """The motion as trajectory points."""
        duration = self.motion.form.duration
        times = np.linspace(0.0, duration, round(RATE * duration) + 1)
        return Trajectory(self.task.feasibility.names, times, *self.motion.at(times)[:3])


def design_task(urdf: str, source: Path, configuration: Configuration, options: MotionOptions) -> DesignTask:
    """Collect everything that a search needs.

    Args:
        urdf: text of the robot description.
        source: its file, from which meshes are searched.
        configuration: parameters; ``model`` is the earlier estimate.
        options: the user's request.

    Raises:
        InputError: something is missing, or no start is feasible.
    """
    earlier = str(configuration["model"])
    # A gap's estimate has no posterior; its identified.urdf has links that were not identified.
    posterior = read_posterior(posterior_path(Path(earlier))) if earlier else None
    session = Session(urdf, configuration, str(source))
    robot, model = session.robot, _model_of(session, posterior)
    if robot.floating_base or not model.layout.efforts:
        raise InputError("motions are designed for arms on a fixed base whose joint efforts can be predicted")
    given = read_joint_limits(Path(options.limits), robot.joint_names) if options.limits else {}
    inertias = np.array([body.parameters for body in robot.bodies])
    limits = motion_limits(robot, given, inertias, options.speed, str(source))
    belief = belief_from_urdf(model, limits)
    if posterior is not None:
        sigmas = _sigmas(belief, EstimateFile.read(Path(earlier)).sigma)
        belief = belief_from_estimate(model, posterior, sigmas, earlier)
    collision = collision_model(options, robot, source)
    feasibility, unwatched = _feasibility(belief, limits, collision, options)
    notes = (*held_base(robot), *limits.notes, *not_watched(collision, unwatched), *robot.inertia_repairs.values())
    slow = _SLOW_SHARE.get(options.aim, _SLOW_SHARE[PREDICTION])
    form = MotionForm(period=options.duration / options.repeats, slow_fraction=slow, repeats=options.repeats)
    return DesignTask(
        feasibility=feasibility,
        belief=belief,
        form=form,
        excluded_pairs=unwatched,
        notes=notes,
    )


def held_base(robot: Robot) -> Iterator[str]:
    """Yield a sentence if several limbs begin at the base: the robot may stand on them, but not in this motion."""
    limbs = [*robot.pinocchio_model.parents][1:].count(0)
    if limbs > 1:
        yield (
            f"{limbs} limbs begin at '{robot.tree.root}', which must not move: hang the robot up or clamp it; the "
            "motion is not for a robot that stands on its legs"
        )


def _model_of(session: Session, posterior: Posterior | None) -> MeasurementModel:
    """The session's model with the effects of an earlier estimate, or else with the effects that every place has."""
    model = session.model
    if posterior is None:
        return model.with_coefficients([index for index, c in enumerate(model.coefficients) if not c.optional])
    identified = {(effect.name, effect.place, effect.parameter, effect.positive) for effect in posterior.effects}
    in_shape = session.loaded.shape_mask(model).tolist()
    chosen = [
        index
        for index, (c, is_in_shape) in enumerate(zip(model.coefficients, in_shape, strict=True))
        if is_in_shape and (c.effect.name, c.place_name, c.parameter, c.positive) in identified
    ]
    return model.with_coefficients(chosen)


def _sigmas(belief: Belief, measured: Mapping[str, float]) -> list[float]:
    """Standard deviations of the channels' noise: the ``measured`` ones, or else the belief's."""
    sigmas = zip(belief.model.channels, belief.sigmas.tolist(), strict=True)
    return [s if (s := measured.get(c.name)) and math.isfinite(s) else default for c, default in sigmas]


def _feasibility(
    belief: Belief, limits: MotionLimits, collision: CollisionModel | None, wish: MotionOptions
) -> tuple[Feasibility, tuple[Pair, ...]]:
    """Feasibility from the first feasible start, and the pairs that are not watched."""
    names = belief.model.robot.joint_names
    if len(wish.start) not in (0, len(names)):
        raise InputError(
            f"--start has {len(wish.start)} numbers, expected {len(names)}: those of {', '.join(names)} [rad, m]"
        )
    candidates = [np.array(wish.start)] if len(wish.start) else list(start_postures(limits))
    unwatched = without_touching(collision, candidates[0])
    errors = []
    for start in candidates:
        try:
            return Feasibility(belief, limits, start, collision, wish.clearance), unwatched
        except InputError as error:
            errors.append(error)
    if len(wish.start):
        raise errors[0]
    reason = f"no feasible start was found among {len(errors)} postures; the first one: {errors[0]}"
    if wish.avoid:
        reason += ", or make room: --avoid is in metres in the base frame, each part of a mesh is its convex hull"
    raise InputError(reason)


def design(task: DesignTask, options: MotionOptions) -> Excitation:
    """Search for a motion, and predict its benefit."""
    random, feasibility = np.random.default_rng(options.seed), task.feasibility
    discrimination = rival_effects(feasibility, Path(options.discriminate)) if options.discriminate else None
    others = typical_motions(feasibility, task.form, random, _OTHERS)
    weight = aim_weight(options.aim, task.belief, others)
    criterion = expected_error(feasibility, weight, task.form)
    searching = partial(options.progress, "searching")
    if discrimination is None:
        motion = Search(feasibility, task.form, criterion).run(random, searching)
    else:
        motion = discriminating_motion(feasibility, task.form, discrimination, random, searching)
    options.progress("comparing", 0.0)
    randoms = [random_feasible(feasibility, task.form, random) for _ in range(_COMPARED)]
    learning = expected_learning(task.belief, weight, motion, randoms)
    decisions = () if discrimination is None else tuple(_decisions(discrimination, motion, randoms))
    return Excitation(
        task=task,
        error=error_description(options.aim),
        motion=motion,
        margins=feasibility.margins(motion),
        learning=learning,
        decisions=decisions,
    )


def _decisions(
    discrimination: DiscriminationCriterion, motion: ExcitingMotion, randoms: Sequence[ExcitingMotion]
) -> Iterator[ExpectedDiscrimination]:
    designed, others = discrimination.differences(motion), [discrimination.differences(random) for random in randoms]
    for i, ambiguity in enumerate(discrimination.ambiguities):
        for j, rival in enumerate(ambiguity.rivals):
            random = float(np.median([other[i][j] for other in others]))
            yield ExpectedDiscrimination(ambiguity.found.label, rival.label, designed[i][j], random)


def rival_effects(feasibility: Feasibility, path: Path) -> DiscriminationCriterion:
    """Criterion of how well a motion discriminates between the rivals in a gap.json.

    Raises InputError naming its ``path``, and the entry that does not fit the robot.
    """
    findings, floor = read_open_findings(path)
    model = feasibility.belief.model.without_effects()
    joints = [joint.name for joint in model.robot.tree.joints if joint.type != "fixed"]
    if others := [name for name in floor if name not in joints and not is_wrench_channel(name)]:
        raise InputError(f"{path}: was written for another robot: {unknown_name('joint', others[0], joints)}")
    belief = belief_from_urdf(model, feasibility.limits)
    belief = replace(belief, sigmas=frozen(_sigmas(belief, floor)))
    return DiscriminationCriterion(belief, [_ambiguity(model, finding) for finding in findings])


def _ambiguity(model: MeasurementModel, finding: OpenFinding) -> Ambiguity:
    """The found effect, first of its variants the one with the constants that were found; and its rivals."""
    found = _any(model, finding.effect, finding.joint, finding.link)
    if isinstance(found.place, OnLink):
        coefficients = finding.body
    else:
        chosen = finding.cls.from_values(finding.values)
        found = replace(found, variants=(chosen, *(variant for variant in found.variants if variant != chosen)))
        coefficients = coefficients_of(finding.cls, finding.values, chosen.parts)
    rivals = tuple(_any(model, rival.effect, rival.joint) for rival in finding.rivals)
    return Ambiguity(found, coefficients, rivals)


def _any(model: MeasurementModel, effect: str, joint: str, link: str = "") -> NamedEffect:
    """An effect with any of its constants, at the place that files call ``joint``."""
    cls = effect_class(effect)
    variants = cls.grid()
    places = {model.places.link(place) or model.places.name(place): place for place in model.places.of(variants[0])}
    place = places[link] if link in places else model.places.named(variants[0], joint)
    location = link or joint
    label = f"{cls.label} at {location}" if location else cls.label
    terms, first = Candidate.of(variants[0], place).terms, variants[0]
    # A payload counts for the parameters that sentences state, without inertia.
    count = len(terms) + bool(first.grid_value) if terms else first.stated_parameter_count or 0
    return NamedEffect(variants, place, label, float(count))
