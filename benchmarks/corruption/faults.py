"""Faults of whole recordings, each at three sizes. Faults of single messages are added to :data:`FAULTS` likewise."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from scipy.signal import savgol_filter

from benchmarks.corruption.recording import ARM3, JOINTS, SOURCES, Recording
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray, IntArray

OTHERS = (ARM3, *SOURCES.values())
"""Recordings of other robots."""
Plant: TypeAlias = Callable[[Recording, Any], Recording]
"""Plants a fault of a size in a recording; returns the recording itself where that changes nothing."""


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A fault that is planted.

    Attributes:
        row: of the list of faults that were seen; 0 if it is not in it.
        name: what is wrong.
        plant: plants it.
        sizes: three of them; places of joints count from the base, those below zero from the tip.
        kind: of the cause that is the right answer, see :mod:`geomid_ros.checks.causes`; empty for an
            answer that the ledger of messages gives.
        joints: the places of the joints that the answer has to name; None for all.
        noted: what the ledger has to say, for a fault of messages.
        refused: what the error has to say, where the recording may be refused.
        said: what a sentence of another kind may say, which is as right.
        wrench: whether it needs a wrench sensor.
        slides: whether it needs a prismatic joint.
        doubted: whether it may have any name, as long as the result of an identification is doubted.
    """

    row: int
    name: str
    plant: Plant
    sizes: Sequence[Any]
    kind: str = ""
    joints: Callable[[Any], tuple[int, ...]] | None = None
    noted: str = ""
    refused: str = ""
    said: str = ""
    wrench: bool = False
    slides: bool = False
    doubted: bool = False

    def fits(self, recording: Recording) -> bool:
        """Whether it can be planted in a recording."""
        slides = any(joint.unit == "N" for joint in recording.robot.joints)
        return bool(recording.source.wrench or not self.wrench) and (slides or not self.slides)


def _efforts(recording: Recording, effort: FloatArray) -> Recording:
    return replace(recording, effort=effort)


def _scaled(recording: Recording, joint: int | None, factor: float) -> Recording:
    effort = recording.effort.copy()
    effort[:, slice(None) if joint is None else joint] *= factor
    return _efforts(recording, effort)


def _one_reversed(recording: Recording, joint: int) -> Recording:
    return _scaled(recording, joint, -1.0)


def _reversed_by(recording: Recording, factor: float) -> Recording:
    return _scaled(recording, None, factor)


def _exchanged(recording: Recording, pair: tuple[int, int]) -> Recording:
    effort = recording.effort.copy()
    effort[:, list(pair)] = effort[:, list(reversed(pair))]
    return _efforts(recording, effort)


def _renamed(recording: Recording, pair: tuple[int, int]) -> Recording:
    """Two joints have each other's names."""
    order = np.arange(recording.effort.shape[1])
    order[list(pair)] = order[list(reversed(pair))]
    return replace(
        recording,
        position=recording.position[:, order],
        velocity=None if recording.velocity is None else recording.velocity[:, order],
        effort=recording.effort[:, order],
    )


def _amperes(recording: Recording, seed: int) -> Recording:
    gains = np.random.default_rng(seed).uniform(8.0, 15.0, recording.effort.shape[1])
    return _efforts(recording, recording.effort / gains)


def _one_in_mnm(recording: Recording, joint: int) -> Recording:
    return _scaled(recording, joint, 1000.0)


def _one_on_motor_side(recording: Recording, joint: int) -> Recording:
    return _scaled(recording, joint, 0.01)


def _degrees(recording: Recording, what: str) -> Recording:
    """Positions, with the speeds or not, in all of the recording or in its second half, of which the first is cut."""
    scale = 180.0 / np.pi
    speeds = recording.velocity if "speeds" not in what or recording.velocity is None else scale * recording.velocity
    whole = replace(recording, position=scale * recording.position, velocity=speeds)
    return whole.part(0.5, 1.0) if "half" in what else whole


def _weight(recording: Recording) -> FloatArray:
    """What the URDF's links weigh at the joints ``(N, joints)``."""
    still = np.zeros_like(recording.position)
    none = np.zeros((len(still), 0))
    stamps = np.round(recording.stamps * 1e9).astype(np.int64)
    poses = Samples(stamps, recording.position, still, still, still, none, none, none, np.zeros((len(still), 0, 6)))
    model = MeasurementModel(recording.robot.with_gravity(recording.gravity), ())
    _, weight = model.predict(poses, model.nominal_parameters)
    return weight


def _compensated(recording: Recording, error: float) -> Recording:
    """By a model whose weights are off by this share."""
    return _efforts(recording, recording.effort - (1.0 + error) * _weight(recording))


def _external(recording: Recording, noise: float) -> Recording:
    """Efforts of contacts alone: noise."""
    size = noise * np.std(recording.effort, axis=0)
    return _efforts(recording, size * np.random.default_rng(0).normal(size=recording.effort.shape))


def _constant(recording: Recording, value: float) -> Recording:
    return _efforts(recording, np.full_like(recording.effort, value))


def _dead(recording: Recording, joint: int) -> Recording:
    return _scaled(recording, joint, 0.0)


def _stuck(recording: Recording, where: tuple[int, float]) -> Recording:
    """One joint's, at a value."""
    joint, value = where
    effort = recording.effort.copy()
    effort[:, joint] = value
    return _efforts(recording, effort)


def _mounted(recording: Recording, angle: float) -> Recording:
    """The configuration has gravity in another direction than it is, by an angle [deg]."""
    gravity = recording.gravity
    across = np.cross(gravity, (0.3, 0.8, 0.52))
    across *= np.linalg.norm(gravity) / np.linalg.norm(across)
    turned = np.cos(np.radians(angle)) * gravity + np.sin(np.radians(angle)) * across
    settings = {**recording.source.settings, "gravity": turned.tolist()}
    return replace(recording, source=replace(recording.source, settings=settings))


def _wrench(change: Callable[[FloatArray, Any], FloatArray]) -> Plant:
    """A change of all wrenches ``(M, 6)``."""
    return lambda recording, size: replace(recording, wrench=change(recording.wrench, size))


def _turned(wrench: FloatArray, axis: int) -> FloatArray:
    """By a right angle about an axis."""
    turn = np.roll(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]), (axis, axis), (0, 1))
    return np.asarray((wrench.reshape(-1, 2, 3) @ turn.T).reshape(-1, 6))


def _late(recording: Recording, seconds: float) -> Recording:
    return replace(recording, wrench_stamps=recording.wrench_stamps + seconds)


def _one(joint: Any) -> tuple[int, ...]:
    return (joint,)


_SHARE = 0.01  # of the messages that are bad
_FIRST = 300  # message that may be


def _chosen(recording: Recording) -> IntArray:
    """The places of bad messages, at random, none of them near another."""
    places = np.arange(_FIRST, len(recording.stamps) - 20, round(1.0 / _SHARE))
    return np.asarray(places + np.random.default_rng(0).integers(-30, 30, len(places)))


def _widest(recording: Recording) -> int:
    return int(np.argmax(np.ptp(recording.position, axis=0)))


def _wrapped(recording: Recording, level: float) -> Recording:
    """At a level [share of the joint's way]."""
    position, joint = recording.position.copy(), _widest(recording)
    at = np.quantile(position[:, joint], level)
    position[:, joint] = np.remainder(position[:, joint] - at, 2.0 * np.pi) + at
    return replace(recording, position=position)


def _glitching(recording: Recording, by: float) -> Recording:
    position, places = recording.position.copy(), _chosen(recording)
    position[places, _widest(recording)] += by
    return replace(recording, position=position)


def _spiking(recording: Recording, ranges: float) -> Recording:
    effort, places = recording.effort.copy(), _chosen(recording)
    joint = int(np.argmax(np.ptp(effort, axis=0)))
    effort[places, joint] += ranges * np.ptp(effort[:, joint])
    return _efforts(recording, effort)


def _early(recording: Recording, seconds: float) -> Recording:
    stamps = recording.stamps.copy()
    stamps[_chosen(recording)] += seconds
    return replace(recording, stamps=stamps)


def _clock_set(recording: Recording, seconds: float) -> Recording:
    """Where the widest joint moves fastest."""
    place = _FIRST + int(np.argmax(np.abs(np.diff(recording.position[_FIRST:-_FIRST, _widest(recording)]))))
    stamps, wrench = recording.stamps.copy(), recording.wrench_stamps.copy()
    wrench[wrench > stamps[place]] += seconds
    stamps[place:] += seconds
    return replace(recording, stamps=stamps, wrench_stamps=wrench)


def _in_bursts(recording: Recording, size: int) -> Recording:
    """Received when the last of each burst is."""
    places = np.arange(len(recording.stamps))
    lasts = np.minimum(places // size * size + size - 1, len(places) - 1)
    return replace(recording, stamps=recording.stamps[lasts] + 1e-6 * (places % size))


def _other_unit(recording: Recording, factor: float) -> Recording:
    effort = recording.effort.copy()
    effort[len(effort) // 2 :] *= factor
    return _efforts(recording, effort)


def _infinite(recording: Recording, speed: float) -> Recording:
    velocity = np.zeros_like(recording.position) if recording.velocity is None else recording.velocity.copy()
    velocity[_chosen(recording), 0] = speed
    return replace(recording, velocity=velocity)


def _tared(recording: Recording, where: tuple[int, float]) -> Recording:
    """One joint's, after a third of the time, by so many standard deviations."""
    joint, size = where
    effort = recording.effort.copy()
    effort[len(effort) // 3 :, joint] += size * np.std(effort[:, joint])
    return _efforts(recording, effort)


def _held(recording: Recording, rate: float) -> Recording:
    times = recording.stamps - recording.stamps[0]
    return _efforts(recording, recording.effort[np.searchsorted(times, np.floor(times * rate) / rate)])


def _cut(recording: Recording, size: float) -> Recording:
    """Where they are smaller than so many standard deviations."""
    effort = recording.effort
    return _efforts(recording, np.where(np.abs(effort) < size * np.std(effort, axis=0), 0.0, effort))


def _copied(recording: Recording, joint: int) -> Recording:
    effort = recording.effort.copy()
    effort[:, joint] = effort[:, joint - 1]
    return _efforts(recording, effort)


def _other_axis(recording: Recording, joint: int) -> Recording:
    """Another axis of the joint's frame in the URDF."""
    name = recording.robot.joint_names[joint]
    pattern = rf'(<joint\b[^>]*name="{re.escape(name)}".*?<axis[^>]*xyz=")([^"]*)'
    before, head, axis, rest = re.split(pattern, recording.urdf, maxsplit=1, flags=re.DOTALL)
    turned = " ".join(np.roll(axis.split(), 2))
    return replace(recording, urdf=before + head + turned + rest)


def _two_robots(recording: Recording, which: int) -> Recording:
    """The second half is of another robot, whose joints have the same names."""
    others = [source for source in OTHERS if source.bag.is_dir() and source.bag != recording.source.bag]
    other = Recording.read(others[which % len(others)])
    half, joints = len(recording.stamps) // 2, min(recording.effort.shape[1], other.effort.shape[1])
    known, times = other.stamps - other.stamps[0], recording.stamps[half:] - recording.stamps[half]
    position, effort = recording.position.copy(), recording.effort.copy()
    for own, of_other in ((position, other.position), (effort, other.effort)):
        for joint in range(joints):
            own[half:, joint] = np.interp(np.mod(times, known[-1]), known, of_other[:, joint])
    return replace(recording, position=position, velocity=None, effort=effort)


def _leaping(recording: Recording, seconds: float) -> Recording:
    """Five times so many seconds are missing, which no stamp says."""
    count, skipped = len(recording.stamps), round(seconds / np.median(np.diff(recording.stamps)))
    whole = count - 5 * skipped
    places = np.arange(whole) + skipped * (6 * np.arange(whole) // whole)
    return replace(
        recording,
        source=replace(recording.source, wrench=""),
        messages=[entry for entry in recording.messages if entry[1] == JOINTS][:whole],
        stamps=recording.stamps[:whole],
        position=recording.position[places],
        velocity=None if recording.velocity is None else recording.velocity[places],
        effort=recording.effort[places],
    )


def _parallel_drive(recording: Recording, joint: int) -> Recording:
    """The motor of a joint carries the next joint's effort, too."""
    effort = recording.effort.copy()
    effort[:, joint] -= effort[:, joint + 1]
    return _efforts(recording, effort)


def _turned_round(recording: Recording, joint: int) -> Recording:
    """Positions and speeds of a joint have the opposite sign."""
    sign = np.ones(recording.position.shape[1])
    sign[joint] = -1.0
    velocity = None if recording.velocity is None else sign * recording.velocity
    return replace(recording, position=sign * recording.position, velocity=velocity)


def _in_unit(recording: Recording, scales: FloatArray) -> Recording:
    """Positions and speeds times scales ``(joints,)``."""
    velocity = None if recording.velocity is None else scales * recording.velocity
    return replace(recording, position=scales * recording.position, velocity=velocity)


def _turning(recording: Recording) -> IntArray:
    return np.flatnonzero([joint.unit != "N" for joint in recording.robot.joints])


def _other_angles(recording: Recording, per_radian: float) -> Recording:
    """All angles in a unit of which a radian has so many."""
    scales = np.ones(recording.position.shape[1])
    scales[_turning(recording)] = per_radian
    return _in_unit(recording, scales)


def _one_in_degrees(recording: Recording, joint: int) -> Recording:
    scales = np.ones(recording.position.shape[1])
    scales[joint] = 180.0 / np.pi
    return _in_unit(recording, scales)


def _slide(recording: Recording, which: int) -> int:
    return int(np.setdiff1d(np.arange(recording.position.shape[1]), _turning(recording))[which])


def _in_millimetres(recording: Recording, which: int) -> Recording:
    scales = np.ones(recording.position.shape[1])
    scales[_slide(recording, which)] = 1000.0
    return _in_unit(recording, scales)


def _other_lengths(recording: Recording, what: str) -> Recording:
    """Origins of joints, of inertials or of both are in mm."""

    def scaled(found: re.Match[str]) -> str:
        return found[1] + " ".join(str(1000.0 * float(entry)) for entry in found[2].split())

    urdf = recording.urdf
    if "joints" in what:
        urdf = re.sub(r'(<joint\b(?:(?!</joint>).)*?<origin[^>]*xyz=")([^"]+)', scaled, urdf, flags=re.DOTALL)
    if "inertials" in what:
        urdf = re.sub(r'(<inertial>(?:(?!</inertial>).)*?<origin[^>]*xyz=")([^"]+)', scaled, urdf, flags=re.DOTALL)
    return replace(recording, urdf=urdf)


def _other_inertias(recording: Recording, what: str) -> Recording:
    """Masses in grams, moments of inertia in g mm^2, or both."""

    def times(factor: float) -> Callable[[re.Match[str]], str]:
        return lambda found: f'{found[1]}"{factor * float(found[2]):.9g}"'

    urdf = recording.urdf
    if "grams" in what:
        urdf = re.sub(r'(<mass\s+value=)"([^"]+)"', times(1e3), urdf)
    if "moments" in what:
        urdf = re.sub(r'(\bi[xyz][xyz]=)"([^"]+)"', times(1e9), urdf)
    return replace(recording, urdf=urdf)


def _other_time(recording: Recording, factor: float) -> Recording:
    """Stamps run so many times as fast; a driver sends the speeds that it measures, or none."""
    stamps = recording.stamps[0] + factor * (recording.stamps - recording.stamps[0])
    begin = recording.messages[0][2]
    messages = [(topic, kind, round(begin + factor * (time - begin)), m) for topic, kind, time, m in recording.messages]
    wrenches = recording.stamps[0] + factor * (recording.wrench_stamps - recording.stamps[0])
    return replace(recording, stamps=stamps, messages=messages, wrench_stamps=wrenches)


def _other_time_without_speeds(recording: Recording, factor: float) -> Recording:
    return replace(_other_time(recording, factor), velocity=None)


def _gravity_of_size(recording: Recording, size: float) -> Recording:
    """The configuration has gravity in another unit, or none."""
    gravity = size / float(np.linalg.norm(recording.gravity)) * recording.gravity
    settings = {**recording.source.settings, "gravity": gravity.tolist()}
    return replace(recording, source=replace(recording.source, settings=settings))


def _of_rated(recording: Recording, parts: float) -> Recording:
    """Efforts are shares of what each joint is rated for, in so many parts of it."""
    limits = recording.robot.effort_limits
    largest = np.max(np.abs(recording.effort), axis=0)
    return _efforts(recording, parts * recording.effort / np.where(np.isfinite(limits), limits, 2.0 * largest))


def _zero_off(recording: Recording, where: tuple[int, float]) -> Recording:
    """By an angle [deg]."""
    joint, angle = where
    position = recording.position.copy()
    position[:, joint] += np.radians(angle)
    return replace(recording, position=position)


def _efforts_late(recording: Recording, seconds: float) -> Recording:
    times = recording.stamps - seconds
    effort = np.array([np.interp(times, recording.stamps, own) for own in recording.effort.T]).T
    return _efforts(recording, effort)


def _unsigned(recording: Recording, which: int) -> Recording:
    """Of the joint whose effort has both signs most evenly, or the next one in this respect."""
    effort = recording.effort.copy()
    joint = np.argsort(np.abs(np.mean(effort > 0.0, axis=0) - 0.5))[which]
    effort[:, joint] = np.abs(effort[:, joint])
    return _efforts(recording, effort)


def _position_frozen(recording: Recording, where: tuple[int, float]) -> Recording:
    """For a share of the time, in the middle."""
    joint, share = where
    position, count = recording.position.copy(), len(recording.stamps)
    begin, end = round((0.5 - 0.5 * share) * count), round((0.5 + 0.5 * share) * count)
    position[begin:end, joint] = position[begin, joint]
    return replace(recording, position=position, velocity=None)


def _clipped(recording: Recording, joint: int) -> Recording:
    """An encoder that does not count beyond the middle of its joint's way."""
    position = recording.position.copy()
    position[:, joint] = np.minimum(position[:, joint], np.median(position[:, joint]))
    return replace(recording, position=position, velocity=None)


def _carried(recording: Recording, share: float) -> Recording:
    """From the middle on the tip carries so much of the robot's mass."""
    robot = recording.robot.with_gravity(recording.gravity)
    bodies = np.array([body.parameters for body in robot.bodies])
    load = np.zeros_like(bodies)
    mass = share * float(np.sum(bodies[:, 0]))
    load[-1] = mass * np.array([1.0, 0.0, 0.0, 0.1, 0.02, 0.0, 0.02, 0.0, 0.0, 0.01])
    period, width = (
        float(np.median(np.diff(recording.stamps))),
        2 * round(0.1 / np.median(np.diff(recording.stamps))) + 5,
    )
    motion = (savgol_filter(recording.position, width, 4, order, period, axis=0) for order in range(3))
    none = np.zeros((len(recording.stamps), 0))
    stamps, wrenches = np.arange(len(none), dtype=np.int64), np.zeros((len(none), 0, 6))
    moved = Samples(stamps, *motion, recording.effort, none, none, none, wrenches)
    rows = robot.joint_effort_rows(*robot.configuration(moved)).reshape(len(none), len(robot.joints), -1)
    later = recording.stamps > np.median(recording.stamps)
    return _efforts(recording, recording.effort + later[:, None] * (rows @ load.ravel()))


def _other_robot(recording: Recording, by: int) -> Recording:
    """Every joint of the URDF has the axis of the joint so many places on."""
    urdf, names = recording.urdf, recording.robot.joint_names
    pattern = r'<joint\b[^>]*name="{}".*?<axis[^>]*xyz="([^"]*)'
    axes = [re.search(pattern.format(re.escape(name)), urdf, re.DOTALL) for name in names]
    spans = sorted((axis.start(1), axis.end(1)) for axis in axes if axis is not None)
    values = [urdf[begin:end] for begin, end in spans]
    for (begin, end), other in reversed([*zip(spans, [*values[by:], *values[:by]], strict=True)]):
        urdf = urdf[:begin] + other + urdf[end:]
    return recording if urdf == recording.urdf else replace(recording, urdf=urdf)


FAULTS = [
    Fault(row=71, name="wraps", plant=_wrapped, sizes=(0.5, 0.3, 0.8), noted="jump by whole turns"),
    Fault(row=73, name="positions jump", plant=_glitching, sizes=(1.5, 0.3, -3.0), noted="jumps, and back"),
    Fault(row=74, name="efforts spike", plant=_spiking, sizes=(20.0, 5.0, -3.0), noted="is a spike"),
    Fault(row=75, name="stamps ahead", plant=_early, sizes=(0.03, 0.1, 0.4), noted="ahead of its time"),
    Fault(row=76, name="clock set", plant=_clock_set, sizes=(0.2, -0.2, 0.1), noted="clock set"),
    Fault(row=77, name="bursts", plant=_in_bursts, sizes=(20, 10, 4), kind="stream"),
    Fault(row=83, name="unit in mid-run", plant=_other_unit, sizes=(1000.0, 0.07, -1.0), kind="stream"),
    Fault(row=87, name="pairs and batches", plant=_in_bursts, sizes=(2, 3, 5), kind="stream"),
    Fault(row=95, name="infinite speeds", plant=_infinite, sizes=(np.inf, -np.inf, 1e300), noted="velocity of"),
    Fault(
        row=72, name="positions in degrees", plant=_degrees, kind="position",
        sizes=("positions and speeds", "positions", "positions and speeds of one half"),
    ),
    Fault(
        row=78, name="constant efforts", plant=_constant, sizes=(0.0, 1.0, -20.0), kind="constant",
        refused="no effort",
    ),
    Fault(row=78, name="an effort is zero", plant=_dead, sizes=(0, 2, -1), kind="constant", joints=_one),
    Fault(
        row=78, name="an effort is constant", plant=_stuck, sizes=((0, 1.0), (2, -20.0), (-1, 0.3)), kind="constant",
        joints=lambda where: where[:1],
    ),
    Fault(row=78, name="gravity compensated", plant=_compensated, sizes=(0.0, 0.1, -0.1), kind="compensated"),
    Fault(row=78, name="external efforts", plant=_external, sizes=(0.01, 0.1, 1.0), kind="unrelated"),
    Fault(row=79, name="all reversed", plant=_reversed_by, sizes=(-1.0, -0.7, -1.5), kind="sign"),
    Fault(row=79, name="one reversed", plant=_one_reversed, sizes=(0, 2, -1), kind="sign", joints=_one),
    Fault(row=79, name="two exchanged", plant=_exchanged, sizes=((0, 1), (1, 2), (2, 4)), kind="order", joints=tuple),
    Fault(row=82, name="names exchanged", plant=_renamed, sizes=((0, 1), (1, 2), (2, 4)), kind="names", joints=tuple),
    Fault(row=80, name="another unit", plant=_reversed_by, sizes=(1000.0, 0.07, 0.01), kind="gain"),
    Fault(row=80, name="amperes", plant=_amperes, sizes=(0, 1, 2), kind="gain"),
    Fault(row=80, name="one in mN m", plant=_one_in_mnm, sizes=(1, 2, 3), kind="gain", joints=_one),
    Fault(row=80, name="one on the motor's side", plant=_one_on_motor_side, sizes=(1, 2, 3), kind="gain", joints=_one),
    Fault(row=81, name="mounted otherwise", plant=_mounted, sizes=(180.0, 90.0, 45.0), kind="gravity"),
    Fault(
        row=84, name="wrench reversed", plant=_wrench(np.multiply), sizes=(-1.0, -0.5, -2.0), kind="wrench", wrench=True
    ),
    Fault(
        row=84, name="wrench in another unit", plant=_wrench(np.multiply), sizes=(1000.0, 0.001, 0.1), kind="wrench",
        wrench=True,
    ),
    Fault(row=84, name="wrench turned", plant=_wrench(_turned), sizes=(0, 1, 2), kind="wrench", wrench=True),
    Fault(row=0, name="offset set", plant=_tared, sizes=((0, 1.0), (1, -1.0), (2, 1.5)), kind="offset",
        joints=lambda where: where[:1]),
    Fault(row=0, name="held efforts", plant=_held, sizes=(5.0, 3.0, 10.0), kind="stream"),
    Fault(row=0, name="dead band", plant=_cut, sizes=(0.5, 0.3, 0.8), kind="stream"),
    Fault(row=0, name="copied efforts", plant=_copied, sizes=(1, 2, -1), kind="stream"),
    Fault(row=111, name="axis of the URDF", plant=_other_axis, sizes=(1, 2), doubted=True),
    Fault(row=112, name="two robots", plant=_two_robots, sizes=(0, 1), doubted=True),
    Fault(row=125, name="positions leap", plant=_leaping, sizes=(0.3, 0.5, 1.0), kind="stream"),
    Fault(row=113, name="parallel drive", plant=_parallel_drive, sizes=(1, 2), doubted=True),
    Fault(row=113, name="position turned round", plant=_turned_round, sizes=(1, 2, 3), doubted=True),
    Fault(
        row=116, name="other angles", plant=_other_angles, sizes=(0.5 / np.pi, 1000.0, 2048.0 / np.pi), kind="position"
    ),
    Fault(row=116, name="one in degrees", plant=_one_in_degrees, sizes=(1, 2, -2), kind="position"),
    Fault(row=115, name="slide in mm", plant=_in_millimetres, sizes=(0, -1), kind="position", slides=True),
    Fault(row=115, name="lengths in mm", plant=_other_lengths, sizes=("joints", "inertials", "joints and inertials"),
        kind="description"),
    Fault(row=113, name="inertias in g", plant=_other_inertias, sizes=("grams", "moments", "grams and moments"),
        kind="description"),
    Fault(
        row=117, name="time", plant=_other_time, sizes=(2.0, 0.5, 1000.0), kind="time", said="stamps run",
        refused="not in seconds",
    ),
    Fault(
        row=117, name="time without speeds", plant=_other_time_without_speeds, sizes=(2.0, 0.5, 1000.0), kind="time",
        refused="not in seconds",
    ),
    Fault(
        row=114, name="gravity in another unit", plant=_gravity_of_size, sizes=(1e-9, 1.0, 981.0, 9810.0),
        kind="gravity",
    ),
    Fault(row=116, name="permille of rated", plant=_of_rated, sizes=(1000.0, 100.0, 1.0), kind="gain"),
    Fault(row=0, name="zero off", plant=_zero_off, sizes=((1, 30.0), (2, -20.0), (1, 90.0)), kind="zero",
        joints=lambda where: where[:1]),
    Fault(row=121, name="efforts late", plant=_efforts_late, sizes=(0.05, 0.1, -0.1), kind="late"),
    Fault(row=0, name="no sign", plant=_unsigned, sizes=(0, 1), kind="magnitude"),
    Fault(row=121, name="position frozen", plant=_position_frozen, sizes=((1, 0.2), (2, 0.3), (0, 0.15)), kind="frozen",
        joints=lambda where: where[:1]),
    Fault(row=121, name="encoder clipped", plant=_clipped, sizes=(0, 1, 2), doubted=True),
    Fault(row=0, name="taken up", plant=_carried, sizes=(0.05, 0.1, 0.2), kind="load"),
    Fault(row=118, name="axes of another robot", plant=_other_robot, sizes=(1, 2), doubted=True),
    Fault(row=90, name="wrench late", plant=_late, sizes=(0.3, 1.0, 3.0), kind="wrench", wrench=True),
]  # fmt: skip
"""What is planted."""
