"""Faults that need no comparison of hypotheses: impossible descriptions, noisy accelerations, channels that repeat one
value for a while, and efforts of other gains than the given ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from geomid_ros.checks.candidates import MASS_FACTOR
from geomid_ros.checks.causes import Cause
from geomid_ros.checks.effort_data import EffortData
from geomid_ros.checks.evidence import LEAST_SIGMA
from geomid_ros.checks.sample_reservoir import FEWEST
from geomid_ros.estimation.estimate import STDS_OF_95, EffectEstimate, is_significant
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.controller import PDController
from geomid_ros.model.effects import effect_class
from geomid_ros.model.robot import STANDARD_GRAVITY
from geomid_ros.model.samples import Samples
from geomid_ros.types import BoolArray, FloatArray, IntArray

_SAME = 1e-6  # fraction of a range: smaller changes are none
_FEWEST = 5  # samples in a row; a filter smears twice as many at each end of a stretch


def impossible_description(subject: EffortData) -> Iterator[Cause]:
    """Yield what is wrong with the URDF, whatever was measured: lengths, centres of mass and radii of gyration that do
    not fit one robot, masses that joints with such limits could not support, or bodies denser than steel."""

    def cause(problem: str, quantity: str, unit: str, right: str, *links: str) -> Cause:
        return Cause.of(
            "description", links, sentence_key="lengths", what=problem, quantity=quantity, unit=unit, right=right
        )

    robot = subject.robot
    bodies = np.array([body.parameters for body in robot.bodies])
    distances = np.linalg.norm(bodies[:, 1:4], axis=1) / bodies[:, 0]
    radii = np.sqrt([0.5 * np.trace(pseudo_inertia.central_inertia(body)) / body[0] for body in bodies])
    length, total = _length(subject), f"the total link mass is {np.sum(bodies[:, 0]):.3g} kg, and "
    if np.median(_denser_than_steel(bodies)) > 0.0:
        yield cause(f"{total}most of its links would be denser than steel", "the masses", "grams", "kg")
    for sizes, what, *units in (
        (distances, "the centre of mass of link '{}' is {:.3g} m from its frame", "centres of mass", "mm", "m"),
        (radii, "the moments of inertia of link '{}' are those of mass {:.3g} m away from its centre",
         "moments of inertia", "g mm^2 or kg mm^2", "kg m^2"),
    ):  # fmt: skip
        most = int(np.argmax(sizes))
        if 0.0 < MASS_FACTOR**2 * length < sizes[most]:
            link = robot.body_names[most]
            problem = f"{what.format(link, sizes[most])}, though all links together are {length:.3g} m long"
            yield cause(problem, *units, link)
    if length > MASS_FACTOR**2 * float(np.sum(radii)) > 0.0:
        problem = f"all links together are {length:.3g} m long, though their mass is within {np.max(radii):.3g} m"
        yield cause(problem, "the origins of joints", "mm", "m")
    borne = robot.effort_limits.copy()  # a limit is wrong if the robot bore more
    borne[subject.joints] = np.maximum(borne[subject.joints], np.max(np.abs(subject.measured), axis=0))
    with np.errstate(divide="ignore"):
        excess = _weights(subject) / borne
    joint = int(np.argmax(excess))
    if excess[joint] > MASS_FACTOR**2:
        carried = f"joint '{robot.joint_names[joint]}' would carry {excess[joint]:.0f} times its limit"
        yield cause(f"{total}{carried}", "the masses", "grams", "kg")


def _length(subject: EffortData) -> float:
    """Sum of the distances from a joint to the next along the moving links, at zero positions."""
    robot, first = subject.robot, subject.samples.select(slice(1))
    frames = robot.link_frames(replace(first, position=np.zeros_like(first.position)))
    moving = [joint for joint in robot.tree.joints if robot.body_of(joint.child)]
    return float(sum(np.linalg.norm(frames[j.child][1] - frames[j.parent][1]) for j in moving))


def _weights(subject: EffortData) -> FloatArray:
    """Largest static efforts of the URDF's links at the recorded positions, within limits ``(joints,)``. Gravity above
    the standard one is reduced to it."""
    samples, gravity, weights = subject.samples, subject.robot.gravity, np.zeros(len(subject.robot.joints))
    within = replace(samples, position=np.clip(samples.position, *subject.robot.position_limits.T))
    on_earth = STANDARD_GRAVITY / max(float(np.linalg.norm(gravity)), STANDARD_GRAVITY)
    weights[subject.joints] = on_earth * np.max(np.abs(subject.with_samples(within).weight), axis=0)
    return weights


def _denser_than_steel(bodies: FloatArray) -> BoolArray:
    """True for bodies ``(B, 10)`` that are far smaller than steel balls of their masses: moments that were too small
    have been raised to those of such balls."""
    traces = [np.trace(pseudo_inertia.central_inertia(body)) for body in bodies]  # twice that of second moments
    least = [6.0 * body[0] * pseudo_inertia.least_gyration(body[0]) ** 2 for body in bodies]
    return np.asarray(MASS_FACTOR * np.array(traces) < np.array(least))


def held_efforts(subject: EffortData) -> Iterator[Cause]:
    """Yield efforts that stay the same for a while in which gravity and motion require changes, once for each joint."""
    rigid = subject.baseline_fit.link_efforts
    for channel, effort in enumerate(subject.measured.T):
        changes = np.abs(np.diff(rigid[:, channel]))
        same = np.abs(np.diff(effort)) <= _SAME * np.ptp(effort)
        begins, ends = _runs(same)
        least = max(float(np.std(effort)), _step(effort[begins]))
        for begin, end in zip(begins, ends, strict=True):
            others = np.delete(same & (changes > LEAST_SIGMA * np.std(effort)), np.arange(begin, end))
            required = float(np.ptp(rigid[begin : end + 1, channel]))
            if end - begin >= _FEWEST and np.mean(others) < LEAST_SIGMA and required > least:
                first, last = (subject.time_of(subject.shares[at]) for at in (begin, end))
                places = [subject.names[channel]]
                yield Cause.of("constant", places, sentence_key="held", asked=required, begin=first, end=last)
                break


def _runs(true: BoolArray) -> tuple[IntArray, IntArray]:
    """First index of each run of ``true (N,)``, and the index after its last."""
    edges = np.diff(np.pad(true.astype(np.int8), 1))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)


def _step(levels: FloatArray) -> float:
    """Least difference between levels at which a channel stays, if only briefly: the step of a quantised channel."""
    gaps = np.diff(np.sort(levels))
    return float(np.min(gaps[gaps > 2.0 * _SAME * np.ptp(levels)], initial=np.inf)) if np.any(gaps > 0.0) else 0.0


def noisy_accelerations(subject: EffortData) -> Iterator[Cause]:
    """Yield the joints at which noise of the accelerations spoils inertias: a fit makes inertial efforts smaller by the
    noise's share of their square (Fuller, "Measurement error models", 1987, section 1.1)."""
    samples, weightless = subject.samples, subject.under_gravity(np.zeros(3))
    if not samples.acceleration_noise.size:
        return

    def mean_square(acceleration: FloatArray) -> FloatArray:
        moved = replace(samples, velocity=np.zeros_like(acceleration), acceleration=acceleration)
        return np.asarray(np.mean(weightless.with_samples(moved).predicted ** 2, axis=0))

    square = mean_square(samples.acceleration)
    lost = mean_square(samples.acceleration_noise) / np.where(square > 0.0, square, np.inf)
    visible = lost * np.minimum(np.sqrt(square), subject.measured_std) > LEAST_SIGMA * subject.measured_std
    if np.any(visible):
        names = [name for name, is_visible in zip(subject.names, visible, strict=True) if is_visible]
        yield Cause.of("noise", names, share=min(float(np.max(lost[visible])), 1.0))


def frozen_position(subject: EffortData) -> Iterator[Cause]:
    """Yield joints whose position is exactly the same for a while, while others move and efforts do not fit that pose,
    or it stops and goes on as no effort makes it.

    Links and friction are fitted to all samples: if they explain these as well as the others nothing is frozen,
    wherever the robot was meanwhile. If a joint really stands still, its brake holds it without any effort, or its
    effort is off by no more friction than elsewhere. If it stops several times, others wait for it, too, as from point
    to point, with friction at rest: then its effort alone counts. A robot at rest as a whole is uninformative.
    """
    positions, efforts = subject.samples.position, subject.measured
    for joint, position in enumerate(positions.T):
        same = np.abs(np.diff(position)) <= _SAME * np.ptp(position)
        still = np.append(False, same) & np.append(same, False) & subject.is_moving
        # A filter smears the step that follows, and is smeared by it.
        around = np.convolve(still, np.ones(4 * _FEWEST + 1), mode="same") > 0.0
        if np.count_nonzero(still) >= _FEWEST and 2 * np.count_nonzero(~around) >= FEWEST:
            changes = np.ptp(efforts[still], axis=0) > LEAST_SIGMA * np.ptp(efforts, axis=0)
            once = len(_runs(still)[0]) == 1
            is_joint = subject.joints == joint
            inside, outside = _residual_rms(subject, still, around, is_joint)
            significant = np.sqrt(1.0 + STDS_OF_95 * np.sqrt(2.0))  # for one pose, whose residuals are a single number
            is_off = (inside > significant * outside) & changes & (once | is_joint)
            moving = np.ptp(positions[still], axis=0) > LEAST_SIGMA * np.ptp(positions, axis=0)
            if np.any(moving) and np.any(is_off):
                yield Cause.of("frozen", [subject.robot.joint_names[joint]], share=np.mean(still))


def _residual_rms(
    subject: EffortData, still: BoolArray, around: BoolArray, is_joint: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """RMS of the efforts' residuals ``(C,)``: of a fit to all samples where a joint is ``still``, or ``around`` that,
    beyond the largest friction for its effort (``is_joint (C,)``) while still; and of a fit to the others, at these."""
    others = subject.select(~around)
    rubbing = np.max(np.abs(others.friction_efforts(subject.nominal)), axis=0)
    allowed = still[:, None] * np.where(is_joint, rubbing, 0.0)
    residual = np.abs(subject.measured - subject.explained(subject.nominal)) / subject.measured_std
    beyond = np.maximum(residual - allowed, 0.0)
    parts = (still, around & subject.is_moving)
    inside, at_ends = (np.sqrt(np.mean(beyond[part] ** 2, axis=0)) for part in parts)
    outside = others.in_units(subject.measured_std).nominal.sticking_sigmas
    return np.maximum(inside, at_ends), outside


def wrong_gains(controller: PDController, samples: Samples, joints: Sequence[str]) -> list[Cause]:
    """Report efforts in messages that are those of other gains, if they are those of any.

    Args:
        controller: with the gains that efforts were computed with.
        samples: with commands and reported efforts, any of a recording.
        joints: names.
    """
    wrong = {}
    for joint, name in enumerate(joints):
        wanted, speed, forward, reported = samples.commands[:, :, joint].T
        errors = np.column_stack([wanted - samples.position[:, joint], speed - samples.velocity[:, joint]])
        given = np.array([controller.kp[joint], controller.kd[joint]])
        effort = reported - forward
        finite = np.isfinite(effort)
        if np.count_nonzero(finite) <= errors.shape[1] or not np.any(effort[finite]):
            continue
        errors, effort = errors[finite], effort[finite]
        fitted = np.linalg.lstsq(errors, effort, rcond=None)[0]
        rest = [float(np.linalg.norm(effort - errors @ gains) / np.linalg.norm(effort)) for gains in (given, fitted)]
        if rest[1] < LEAST_SIGMA < rest[0] and np.any(np.abs(fitted - given) > LEAST_SIGMA * given):
            wrong[name] = f"{fitted[0]:.3g}:{fitted[1]:.3g} at '{name}', given is {given[0]:g}:{given[1]:g}"
    described = "; ".join(wrong.values())
    sentence = f"the reported efforts are those of other gains: {described}. Correct command.gains (--gains)"
    return [Cause(kind="gains", sentence=sentence, places=tuple(wrong))] if wrong else []


def encoder_zeros(controller: PDController, effects: Sequence[EffectEstimate], joints: Sequence[str]) -> list[str]:
    """Sentence with the apparent encoder zeros between set-points and positions: identified effort offsets over kp."""
    stiffness = dict(zip(joints, controller.kp.tolist(), strict=True))
    significant = [
        f"{1e3 * offset / stiffness[effect.joint]:+.1f} mrad (mm) at '{effect.joint}'"
        for effect in effects
        if (offset := effect_class(effect.name).effort_shift({effect.parameter: effect.value}))
        and is_significant(offset, effect.std)
    ]
    sentence = f"offsets of efforts are as large as those of encoders whose zeros are off by {', '.join(significant)}"
    return [sentence] if significant else []
