"""The bench on realistic robots: its draws, how large a change is by an independent route, and its counting."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.signal import butter, sosfiltfilt

from benchmarks.blind.realistic.case import RealisticCase
from benchmarks.blind.realistic.figures import figures
from benchmarks.blind.realistic.judging import judge
from benchmarks.blind.realistic.sizing import LEAST, MOST, sized
from geomid_ros.simulation.description import robot_description
from geomid_ros.simulation.effects import noiseless_measurement
from geomid_ros.simulation.options import Hidden, SimulationOptions
from geomid_ros.simulation.realistic import build_realistic
from geomid_ros.simulation.recording import control_loop, record
from geomid_ros.types import FloatArray

pytest.importorskip("mujoco")

FOLDER = Path(__file__).parents[2] / "benchmarks" / "blind" / "realistic"
SHORT = SimulationOptions(
    robot="arm3",
    seed=6,
    motion_seed=1,
    realistic=True,
    duration=6.0,
    rate=125.0,
    hide=(),
    motion_period=4.0,
    longest_step=1e-3,
)


def test_a_change_lies_between_three_and_ten_floors() -> None:
    """With pinocchio's regressor for the inertias and the truth's noise for the floor, the same comes out."""
    change = Hidden("coulomb_friction", "joint2", None, {"level": 0.1})
    case, shown = sized(RealisticCase(6, SHORT, change, 5.0))
    assert LEAST <= shown.alone <= shown.both <= MOST
    then, now = (before_noise(options) for options in (replace(case.now, hide=()), case.now))
    rows, floor = then[1], then[2]
    changed = low(now[0] - then[0])
    matrix = (rows / floor[None, :, None]).reshape(-1, rows.shape[-1])
    target = (changed / floor).ravel()
    rest = target - matrix @ np.linalg.lstsq(matrix, target, rcond=1e-10)[0]
    worst = np.sqrt(np.mean(rest.reshape(changed.shape) ** 2, axis=0)).max()
    assert worst == pytest.approx(shown.alone, rel=0.1)


def before_noise(options: SimulationOptions) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Measured efforts, rows of pinocchio's regressor, and the floor."""
    robot = build_realistic(options)
    trace = record(robot, control_loop(robot, options), options)
    model = pin.buildModelFromXML(robot_description(options.robot))
    data = model.createData()
    states = list(zip(trace.position, trace.velocity, trace.acceleration, strict=True))[::6]
    rows = np.array([pin.computeJointTorqueRegressor(model, data, *state).copy() for state in states])
    motors = robot.motors
    waves = motors.cycles[:, None] * trace.position + motors.phase[:, None]
    unseen = (motors.cogging[:, None] * np.sin(waves)).sum(axis=0)
    unseen += motors.ripple * trace.effort * np.sin(2.0 * waves[0])
    noise = robot.sensors.effort_noise**2 + robot.sensors.effort_step**2 / 12.0
    band = low(np.random.default_rng(1).standard_normal((200_000, 1))).var()
    floor = np.sqrt(np.mean(low(unseen - unseen.mean(axis=0)) ** 2, axis=0) + band * noise)
    return noiseless_measurement(trace, robot.plant.joints, robot.effects).effort, rows, floor


def low(effort: FloatArray) -> FloatArray:
    filtered = sosfiltfilt(butter(2, 5.0, fs=SHORT.rate, output="sos"), effort, axis=0)
    return np.asarray(filtered[::6], dtype=np.float64)


COULOMB = {"effect": "coulomb_friction", "joint": "j1", "parameters": {"level": 2.0}}


def finding(effect: str, joint: str, confidence: str = "confident", **values: float) -> dict[str, Any]:
    parameters = {name: {"value": value, "std": 0.1, "unit": ""} for name, value in values.items()}
    shared = {"probability": 0.9, "confidence": confidence, "rivals": [], "loss": 100.0}
    return {"effect": effect, "joint": joint, "parameters": parameters, **shared}


def document(*findings: dict[str, Any], change: dict[str, Any] = COULOMB, alone: float = 4.0) -> dict[str, Any]:
    gap = {
        "verdict": "named",
        "findings": list(findings),
        "links": [],
        "gap": {"after": {"j1": 1.2, "j2": None}},
        "resimulated": {"after": {"j1": 1.5, "j2": 3.0}},
    }
    truth = {
        "effects": [change],
        "standing": [
            {"effect": "effort_gain", "joint": "j1", "parameters": {"gain": 1.1}},
            {"effect": "effort_gain", "joint": "j2", "parameters": {"gain": 1.001}},
            {"effect": "rotor_inertia", "joint": "j2", "parameters": {"inertia": 0.5}},
            {"effect": "effort_delay", "joint": "", "parameters": {"delay": 0.001}},
        ],
        "joints": ["j1", "j2"],
        "links": [{"joint": "j1", "mass_error": 0.2}, {"joint": "j2", "mass_error": 0.01}],
        "friction": {"level": [3.0, 1.0], "viscous": [1.0, 1.0]},
        "warm_up": {"excess": [0.0, 0.0], "time": 60.0},
        "options": {"duration": 30.0},
    }
    recorded = {"case": {"was": {"robot": "arm3"}}, "shown": {"both": 5.0, "alone": alone}, "truth": truth}
    return {"seed": 1, "recorded": recorded, **{name: {"gap": gap, "seconds": 9.0} for name in ("model", "urdf")}}


def test_the_first_name_has_to_be_the_change() -> None:
    right, other = finding("coulomb_friction", "j1", level=5.5), finding("viscous_friction", "j2", coefficient=1.0)
    assert judge(document(right, other), "model").first
    late = judge(document(other, right), "model")
    assert (late.first, late.right, late.listed) == (False, True, True)
    unsure = judge(document(finding("coulomb_friction", "j1", "tentative", level=5.5)), "model")
    assert (unsure.first, unsure.right, unsure.listed) == (False, False, True)
    assert judge(document(finding("stribeck_friction", "j1", level=5.5)), "model").first
    assert not judge(document(finding("coulomb_friction", "j2", level=1.0)), "model").listed


@pytest.mark.parametrize(
    ("effect", "joint", "situation", "wrong"),
    [
        ("spring", "j1", "urdf", True),
        ("rotor_inertia", "j1", "urdf", False),
        ("effort_gain", "j1", "model", False),
        ("effort_gain", "j2", "model", True),
        ("link_heavier", "j1", "urdf", False),
        ("link_lighter", "j1", "urdf", True),
        ("link_heavier", "j1", "model", True),
    ],
)
def test_a_name_is_wrong_where_the_robot_has_no_such_thing(
    effect: str, joint: str, situation: str, wrong: bool
) -> None:
    case = judge(document(finding(effect, joint, value=1.0)), situation)
    assert case.wrong == (((effect, joint),) if wrong else ())
    assert judge(document(finding(effect, joint, "tentative", value=1.0)), situation).wrong == ()


def test_sizes_are_measured_efforts_whole_or_added() -> None:
    """Friction of 3 + 2 at a gain of 1.1 is 5.5, and 2.2 were added."""
    (whole,) = judge(document(finding("coulomb_friction", "j1", level=5.7)), "urdf").sizes
    assert whole.off == pytest.approx(0.2 / 5.5)
    assert whole.sigmas == pytest.approx(2.0)
    (added,) = judge(document(finding("coulomb_friction", "j1", level=2.1)), "model").sizes
    assert added.off == pytest.approx(0.1 / 2.2)
    (rotor,) = judge(document(finding("rotor_inertia", "j2", inertia=0.5)), "urdf").sizes
    assert rotor.off == pytest.approx(0.001 / 1.001)
    assert judge(document(finding("spring", "j2", stiffness=1.0)), "urdf").sizes == ()


def test_the_table_counts() -> None:
    right, wrong = finding("coulomb_friction", "j1", level=5.5), finding("spring", "j2", stiffness=1.0)
    documents = [document(right), document(right, wrong), document(wrong, alone=1.0)]
    table = {
        line.what: (line.value, line.count)
        for line in figures([judge(each, situation) for each in documents for situation in ("model", "urdf")])
    }
    assert table["with --model: the change named first and confident"] == (pytest.approx(200.0 / 3.0), 3)
    assert table["URDF alone: right and confident"] == (100.0, 2)
    assert table["with --model: wrong confident names"] == (2.0, 3)
    assert table["with --model: simulated again after, largest"] == (3.0, 3)
    assert table["all confident sizes: error, median"] == (pytest.approx(0.0, abs=1e-9), 4)
