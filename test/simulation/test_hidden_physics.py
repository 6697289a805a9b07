"""Every hidden effect does to the efforts what its formula says: pinocchio with the true inertias, and the formula."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from files.recordings import QUICK
from scipy.interpolate import CubicSpline

from geomid_ros.simulation.description import WRIST_FRAME
from geomid_ros.simulation.effect_sizes import SIZES
from geomid_ros.simulation.effects import noiseless_measurement
from geomid_ros.simulation.motion import RunTrace
from geomid_ros.simulation.options import Hidden, SimulationOptions
from geomid_ros.types import FloatArray

from .conftest import Run, simulated

pytest.importorskip("mujoco")

EXACT = 1e-9  # N, N m: rounding
MOVING = 0.06  # rad/s; below, MuJoCo's dry friction is not yet constant
OPTIONS = SimulationOptions(robot="arm3", seed=3, duration=4.0, wrench_frame=WRIST_FRAME, longest_step=QUICK)


@dataclass(frozen=True)
class Situation:
    """A run, what perfect sensors show of it, and where the effect is, in pinocchio's order of joints."""

    run: Run
    seen: RunTrace
    entry: dict[str, Any]

    def __getitem__(self, parameter: str) -> float:
        return float(self.entry["parameters"][parameter])

    def index(self, key: str = "joint") -> int:
        return list(self.run.independent.model.names).index(self.entry[key]) - 1

    @property
    def position(self) -> FloatArray:
        return self.run.trace.position[:, self.index()]

    @property
    def velocity(self) -> FloatArray:
        return self.run.trace.velocity[:, self.index()]

    @property
    def acceleration(self) -> FloatArray:
        return self.run.trace.acceleration[:, self.index()]

    def rigid(self, model: Any = None) -> FloatArray:
        """Efforts ``(T, n)`` of the true bodies, or of another ``model``."""
        model = model or self.run.independent.model
        data = model.createData()
        trace = self.run.trace
        rows = zip(trace.position, trace.velocity, trace.acceleration, strict=True)
        return np.array([pin.rnea(model, data, *row) for row in rows])

    def at_joint(self, column: FloatArray) -> FloatArray:
        """``column (T,)`` at the effect's joint, nothing at the others."""
        every = np.zeros_like(self.run.trace.effort)
        every[:, self.index()] = column
        return every


def situation(hidden: Hidden, folder: Path, options: SimulationOptions = OPTIONS) -> Situation:
    run = simulated(replace(options, hide=(hidden,)), folder)
    seen = noiseless_measurement(run.trace, run.robot.plant.joints, run.robot.effects)
    return Situation(run, seen, run.independent.truth["effects"][0])


def dry(level: Callable[[Situation], FloatArray | float]) -> Callable[[Situation], FloatArray]:
    return lambda s: s.at_joint(level(s) * np.sign(s.velocity))


def stribeck(s: Situation) -> FloatArray:
    return s["level"] + s["excess"] * np.exp(-((s.velocity / s["speed"]) ** 2))


def bent(s: Situation) -> FloatArray:
    return s["level"] * (1.0 + s["modulation"] * np.sin(s["cycles"] * s.position + s["phase"]))


def cable(s: Situation) -> FloatArray:
    wound = s.position + s["ratio"] * s.run.trace.position[:, s.index("other")] - s["start"]
    tension = np.where(wound > 0.0, s["stiffness"] * wound, 0.0)
    assert np.mean(wound > 0.0) > 0.1
    efforts = s.at_joint(tension)
    efforts[:, s.index("other")] = s["ratio"] * tension
    return efforts


def tilted(s: Situation) -> FloatArray:
    model = s.run.independent.model.copy()
    model.gravity.linear = pin.exp3(np.array([s["tilt_x"], s["tilt_y"], 0.0])).T @ np.array([0.0, 0.0, -9.81])
    return s.rigid(model) - s.rigid()


def loaded(s: Situation) -> FloatArray:
    moments = pin.Symmetric3(np.array([s[name] for name in ("ixx", "ixy", "iyy", "ixz", "iyz", "izz")]))
    body = pin.Inertia(s["mass"], np.array([s["com_x"], s["com_y"], s["com_z"]]), moments.matrix())
    model = s.run.independent.model.copy()
    frame = model.frames[model.getFrameId(s.entry["link"])]
    assert model.names[frame.parentJoint] == s.entry["joint"]
    model.appendBodyToJoint(frame.parentJoint, body, frame.placement)
    return s.rigid(model) - s.rigid()


FORMULAS: dict[str, Callable[[Situation], FloatArray]] = {
    "viscous_friction": lambda s: s.at_joint(s["coefficient"] * s.velocity),
    "coulomb_friction": dry(lambda s: s["level"]),
    "stribeck_friction": dry(stribeck),
    "load_friction": dry(lambda s: s["coefficient"] * np.abs(s.rigid()[:, s.index()])),
    "rotor_inertia": lambda s: s.at_joint(s["inertia"] * s.acceleration),
    "spring": lambda s: s.at_joint(s["stiffness"] * (s.position - s["equilibrium"])),
    "effort_offset": lambda s: s.at_joint(np.full(len(s.position), s["offset"])),
    "effort_gain": lambda s: s.at_joint((s["gain"] - 1.0) * s.rigid()[:, s.index()]),
    "gravity_tilt": tilted,
    "payload": loaded,
    "wrench_offset": lambda s: np.zeros_like(s.run.trace.effort),
    "cogging": lambda s: s.at_joint(s["amplitude"] * np.sin(s["cycles"] * s.position + s["phase"])),
    "cable_force": cable,
    "drift": lambda s: s.at_joint(s["rate"] * s.run.trace.time),
    "position_friction": dry(bent),
    "joint_coupling": lambda s: s.at_joint(s["coefficient"] * s.run.trace.velocity[:, s.index("other")]),
}
ELSEWHERE = {"effort_delay", "joint_elasticity", "backlash"}


def test_every_effect_is_checked() -> None:
    assert FORMULAS.keys() | ELSEWHERE == set(SIZES)


@pytest.mark.parametrize("effect", FORMULAS)
def test_what_it_adds_to_the_efforts(effect: str, tmp_path: Path) -> None:
    s = situation(Hidden(effect), tmp_path)
    added, expected = s.seen.effort - s.rigid(), FORMULAS[effect](s)
    sliding = np.abs(s.velocity) > MOVING if effect.endswith("friction") else np.full(len(added), True)
    assert sliding.mean() > 0.7
    np.testing.assert_allclose(added[sliding], expected[sliding], rtol=0.0, atol=EXACT)
    written = s.run.independent.truth["contributions"]["effort"]
    np.testing.assert_allclose(np.sqrt(np.mean(added**2, axis=0)), written, rtol=1e-6, atol=EXACT)


@pytest.mark.parametrize("delay", [0.0123, -0.02])
def test_late_and_early_efforts(delay: float, tmp_path: Path) -> None:
    """Early ones move to the end."""
    s = situation(Hidden("effort_delay", "", delay), tmp_path)
    true = CubicSpline(s.run.trace.time, s.rigid())
    inside = slice(200, -6)
    expected = true(s.run.trace.time - delay)[inside]
    assert np.abs(expected - s.rigid()[inside]).max() > 0.1
    np.testing.assert_allclose(s.seen.effort[inside], expected, rtol=0.0, atol=2e-3)
    assert np.abs(np.diff(s.seen.effort[-3:], axis=0)).min() > 1e-4


def elastic(entry: dict[str, Any], turned: float, rate: float) -> float:
    return float(entry["stiffness"] * turned + entry["damping"] * rate)


def flanks(entry: dict[str, Any], turned: float, rate: float) -> float:
    """They press at either side of the gap and never pull."""
    for side in (-1.0, 1.0):
        pressed = side * turned - 0.5 * entry["gap"]
        if pressed > 0.0:
            return float(side * max(entry["stiffness"] * pressed + entry["damping"] * side * rate, 0.0))
    return 0.0


@pytest.mark.parametrize(("effect", "law"), [("joint_elasticity", elastic), ("backlash", flanks)])
def test_a_gear_that_gives(effect: str, law: Callable[[dict[str, Any], float, float], float], tmp_path: Path) -> None:
    """At any state the link obeys the rigid body's equation under the gear's effort, and the rotor its own."""
    s = situation(Hidden(effect, "joint2"), tmp_path, replace(OPTIONS, duration=0.5))
    assert np.abs(s.run.trace.acceleration[0]).max() < 1e-6, "it starts wound up"
    plant, model, at = s.run.robot.plant, s.run.independent.model, s.index()
    data, rng = model.createData(), np.random.default_rng(5)
    play = int(plant.driven[at]) + 1
    for width in (1e-3, 1e-2, 3e-2) * 5:
        position, velocity = rng.uniform(-1.0, 1.0, (2, 4))
        position[play], velocity[play] = width * rng.uniform(-1.0, 1.0, 2)
        effort = rng.uniform(-1.0, 1.0, 3)
        acceleration = plant.acceleration(position, velocity, effort)
        link = [values[plant.driven] + values[play] * np.eye(3)[at] for values in (position, velocity, acceleration)]
        gear = -law(s.entry["parameters"], position[play], velocity[play])
        assert effort[at] == pytest.approx(gear + s["rotor_inertia"] * acceleration[plant.driven[at]], abs=1e-7)
        expected = np.where(np.arange(3) == at, gear, effort)
        np.testing.assert_allclose(pin.rnea(model, data, *link), expected, rtol=1e-9, atol=1e-7)


def test_wrench_offset_shows_in_the_wrench_only(tmp_path: Path) -> None:
    s = situation(Hidden("wrench_offset"), tmp_path)
    offset = [s[name] for name in ("fx", "fy", "fz", "tx", "ty", "tz")]
    expected = np.broadcast_to(offset, s.seen.wrench.shape)
    np.testing.assert_allclose(s.seen.wrench - s.run.trace.wrench, expected, rtol=0.0, atol=EXACT)


def test_a_payload_behind_the_sensor_weighs_on_it(tmp_path: Path) -> None:
    s = situation(Hidden("payload", "tool", 0.4), tmp_path)
    bare = s.run.independent.carried_wrench(s.run.trace, WRIST_FRAME, "tool")
    added = np.linalg.norm(s.run.trace.wrench[0, :3]) - np.linalg.norm(bare[0, :3])
    assert added == pytest.approx(9.81 * 0.4, rel=1e-6)
