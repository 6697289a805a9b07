"""(d) A simulated person on a force plate: the truth is known.

The human of example-robot-data moves smoothly and at random. Its bodies differ from the URDF's as a real person's from
a textbook's; pinocchio's recursive algorithm gives what the plate under it measures; the rows are made from a motion
with the errors of a camera's tracking.
"""

from __future__ import annotations

from importlib.metadata import files
from pathlib import Path

import numpy as np
import pinocchio as pin
from matplotlib.figure import Figure

from benchmarks.comparison import Outcome, compare, link_distances, show
from benchmarks.moving_base import moving_base
from benchmarks.problem import Problem, Rows
from benchmarks.report import Report
from geomid_ros.geometry import pseudo_inertia
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.measurement_model import MeasurementModel
from geomid_ros.model.robot import Robot
from geomid_ros.model.samples import Samples
from geomid_ros.types import FloatArray

_URDF = "human_description/robots/human.urdf"
_STAND_INS = ("left_clavicle", "right_clavicle")  # of 0.16 kg: no bodies of their own
_AXES = ("tx", "ty", "fz")
_RATE = 30.0  # Hz
_NOISE = np.array([1.0, 1.0, 3.0])  # standard deviations of the plate [N m, N m, N]
_SWING = 0.35  # amplitude of a joint, as a share of its range
_SWAY = np.array([0.05, 0.05, 0.03, 0.15, 0.15, 0.3])  # of the pelvis [m, rad]
_TRACKING = 0.015  # amplitude of the tracking's error [rad], a third of it in m for the pelvis
_FREQUENCIES = (0.15, 1.2)  # Hz
_TONES = 4
_MASS_ERROR, _SIZE_ERROR, _AXES_ERROR = 0.2, 0.12, 0.05  # relative, relative, rad
_CENTRE_ERROR = 0.2  # of the body's standard deviation in that direction


class _Motion:
    """Sums of sinusoids with random frequencies and phases: positions with both derivatives."""

    def __init__(self, rng: np.random.Generator, centres: FloatArray, amplitudes: FloatArray) -> None:
        shape = (_TONES, len(centres))
        self._centres = centres
        self._speeds = 2.0 * np.pi * rng.uniform(*_FREQUENCIES, size=shape)
        self._phases = rng.uniform(0.0, 2.0 * np.pi, size=shape)
        self._sizes = amplitudes * rng.dirichlet(np.ones(_TONES), size=len(centres)).T

    def at(self, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position, velocity and acceleration, each ``(N, coordinates)``."""
        angles = self._speeds * times[:, None, None] + self._phases
        position = self._centres + np.sum(self._sizes * np.sin(angles), axis=1)
        velocity = np.sum(self._sizes * self._speeds * np.cos(angles), axis=1)
        acceleration = -np.sum(self._sizes * self._speeds**2 * np.sin(angles), axis=1)
        return position, velocity, acceleration


def simulated_person(instants: int = 1000, held_out: int = 500, seed: int = 0, errors: float = 1.0) -> Problem:
    """Three rows per instant: the plate's moments about x and y, and its vertical force.

    ``errors`` scales how far the person's bodies are from the URDF's.
    """
    (path,) = (file for file in files("example-robot-data") or () if file.as_posix().endswith(_URDF))
    text = Path(str(path.locate())).read_text(encoding="utf-8")
    robot = Robot(text, floating_base=True, source=_URDF)
    links = [name for name in robot.body_names if name not in _STAND_INS]
    model = MeasurementModel(robot, (), [WrenchSensor("plate", "world", "external", _AXES)], links)
    rng = np.random.default_rng(seed)
    exact, tracked = _motions(rng, text, instants + held_out)
    truth = _another_person(rng, model.nominal_inertias.reshape(-1, 10), errors)
    wrenches = _plate(text, dict(zip(links, truth, strict=True)), robot, exact)
    wrenches[:, [3, 4, 2]] += _NOISE * rng.normal(size=(len(wrenches), 3))
    rows = model.rows(_with(tracked, wrenches))
    count = len(_AXES)
    everything = Rows(
        rows.coefficients.reshape(-1, model.dimension),
        rows.targets.ravel(),
        np.tile(_NOISE, len(wrenches)),
        np.tile(np.arange(count), len(wrenches)),
        np.repeat(np.arange(len(wrenches)), count),
    )
    train, validation = everything.until(instants / (instants + held_out))
    manifold = model.manifold(np.zeros(0))
    return Problem(
        "simulated person", ("Mx", "My", "Fz"), manifold, model.nominal_inertias, train, validation, truth.ravel()
    )


def run(report: Report) -> None:
    """The table with all methods, and how far each leaves each link from the truth."""
    problem = simulated_person()
    outcomes = compare(problem, report)
    caption = (
        f"{len(problem.train)} rows to train on, {len(problem.validation)} later ones to judge by. RMS of Mx, My [N m] "
        "and Fz [N]; the truth itself leaves "
        + " ".join(f"{v:.3g}" for v in problem.validation.rms(problem.truth))
        + ", by errors of the tracking mostly. To truth: mean geodesic distance of a link. The rest as in (c)."
    )
    show(problem, outcomes, report, "(d) A simulated person on a force plate", caption)
    report.picture("person_to_truth", _draw(problem, outcomes))


def _draw(problem: Problem, outcomes: list[Outcome]) -> Figure:
    """One dot per link and method."""
    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    panel = figure.subplots()
    shown = [outcome for outcome in outcomes if np.isfinite(outcome.from_prior)]
    for place, outcome in enumerate(shown):
        distances = link_distances(problem, problem.truth, outcome.parameters)
        panel.plot(distances, np.full(len(distances), place), "o", alpha=0.5, markersize=5, color="tab:blue")
        panel.plot(np.mean(distances), place, "k|", markersize=16, markeredgewidth=2)
    panel.set_yticks(range(len(shown)), [outcome.method for outcome in shown])
    panel.invert_yaxis()
    panel.set_xscale("log")
    panel.grid(axis="x", which="both", alpha=0.3)
    panel.set_xlabel("geodesic distance of each link to the truth (bar: mean)")
    return figure


def _motions(rng: np.random.Generator, text: str, count: int) -> tuple[Samples, Samples]:
    """The motion itself, and the motion as it was tracked."""
    limits = pin.buildModelFromXML(text)
    low, high = limits.lowerPositionLimit, limits.upperPositionLimit
    reach = _SWING * np.minimum(0.5 * (high - low), 1.0)
    centres = np.clip(0.0, low + reach, high - reach)
    joints = _Motion(rng, centres, reach)
    base = _Motion(rng, np.array([0.0, 0.0, 0.95, 0.0, 0.0, 0.0]), _SWAY)
    joint_error = _Motion(rng, np.zeros(len(reach)), np.full(len(reach), _TRACKING))
    base_error = _Motion(rng, np.zeros(6), _TRACKING * np.array([1 / 3, 1 / 3, 1 / 3, 1.0, 1.0, 1.0]))
    times = np.arange(count) / _RATE
    exact_joints, exact_base = np.array(joints.at(times)), np.array(base.at(times))
    tracked_joints = exact_joints + np.array(joint_error.at(times))
    tracked_base = exact_base + np.array(base_error.at(times))
    return _samples(exact_joints, exact_base), _samples(tracked_joints, tracked_base)


def _samples(joints: FloatArray, base: FloatArray) -> Samples:
    """From ``(3, N, ...)``: positions, velocities, accelerations; of the base, translation and rotation vector."""
    count, nothing = joints.shape[1], np.full_like(joints[0], np.nan)
    return Samples(np.arange(count), *joints, nothing, *moving_base(base), np.zeros((count, 1, 6)))


def _with(samples: Samples, wrenches: FloatArray) -> Samples:
    return Samples(**{**vars(samples), "wrenches": wrenches[:, None]})


def _another_person(rng: np.random.Generator, bodies: FloatArray, errors: float) -> FloatArray:
    """Bodies ``(links, 10)`` of other mass, size, centre of mass and principal axes."""
    others = np.empty_like(bodies)
    for k, body in enumerate(bodies):
        second = pseudo_inertia.from_parameters(body)
        centre = second[:3, 3] / second[3, 3]
        variances, axes = np.linalg.eigh(second[:3, :3] / second[3, 3] - np.outer(centre, centre))
        centre = centre + errors * _CENTRE_ERROR * axes @ (np.sqrt(variances) * rng.normal(size=3))
        axes = axes @ pin.exp3(errors * _AXES_ERROR * rng.normal(size=3))
        spread = np.exp(errors * _SIZE_ERROR * rng.normal(size=3)) * np.sqrt(variances)
        covariance = (axes * spread**2) @ axes.T
        mass = body[0] * np.exp(errors * _MASS_ERROR * rng.normal())
        others[k] = pseudo_inertia.assemble(
            np.array(mass), centre, mass * (np.trace(covariance) * np.eye(3) - covariance)
        )
    return others


def _plate(text: str, bodies: dict[str, FloatArray], robot: Robot, samples: Samples) -> FloatArray:
    """What the plate measures ``(N, 6)``, force and moment about the world's origin, by recursive Newton-Euler."""
    model = pin.buildModelFromXML(text, pin.JointModelFreeFlyer())
    for link, parameters in bodies.items():
        frame = model.frames[model.getFrameId(link, pin.BODY)]
        nominal = robot.bodies[robot.body_names.index(link)].parameters
        change = frame.placement.act(pin.Inertia.FromDynamicParameters(parameters)).toDynamicParameters()
        change -= frame.placement.act(pin.Inertia.FromDynamicParameters(nominal)).toDynamicParameters()
        index = frame.parentJoint
        changed = model.inertias[index].toDynamicParameters() + change
        model.inertias[index] = pin.Inertia.FromDynamicParameters(changed)
    data = model.createData()
    wrenches = np.empty((len(samples), 6))
    for k in range(len(samples)):
        q = np.concatenate([samples.base_pose[k], samples.position[k]])
        v = np.concatenate([samples.base_velocity[k], samples.velocity[k]])
        a = np.concatenate([samples.base_acceleration[k], samples.acceleration[k]])
        on_base = pin.Force(pin.rnea(model, data, q, v, a)[:6])
        wrenches[k] = pin.XYZQUATToSE3(samples.base_pose[k]).act(on_base).vector
    return wrenches


if __name__ == "__main__":
    run(Report())
