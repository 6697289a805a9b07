"""Realistic robots: friction against theorems, rigid bodies against pinocchio, sensors against what they declare."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from files.recordings import recorded

from geomid_ros.errors import InputError
from geomid_ros.simulation.options import LINK_MASS, Hidden, SimulationOptions
from geomid_ros.simulation.realistic import LuGre, RealisticRobot, arrival_mask, build_realistic
from geomid_ros.simulation.recording import control_loop, simulate
from geomid_ros.types import FloatArray

from .independent import true_urdf
from .reading import messages

pytest.importorskip("mujoco")

OPTIONS = SimulationOptions(robot="arm3", seed=4, realistic=True, duration=3.0, rate=250.0, hide=())
FRICTION = LuGre(*(np.array([value]) for value in (2.0, 1.0, 0.05, 4000.0, 3.0, 0.5)))
STEP = 2e-4


@cache
def robot() -> RealisticRobot:
    return build_realistic(OPTIONS)


def slid(friction: LuGre, velocities: FloatArray, z: FloatArray, step: float = STEP) -> tuple[FloatArray, FloatArray]:
    """Bend and friction ``(T, n)`` after each of T steps at these velocities."""
    bends, forces = [], []
    for velocity in velocities:
        dry = friction.sliding(velocity)
        z = friction.bent(z, velocity, dry, step)
        bends.append(z)
        forces.append(friction.force(z, velocity, dry))
    return np.array(bends), np.array(forces)


@pytest.mark.parametrize("speed", [1e-3, 0.05, -2.0])
def test_steady_sliding_meets_stribecks_curve(speed: float) -> None:
    _, forces = slid(FRICTION, np.full((2000, 1), speed), np.zeros(1), step=0.02)
    curve = np.sign(speed) * (2.0 + np.exp(-((speed / 0.05) ** 2))) + 0.5 * speed
    assert forces[-1, 0] == pytest.approx(curve, rel=1e-9)


def test_it_never_drives() -> None:
    """``F v >= d/dt (stiffness z^2 / 2)`` for every state that can be reached, also where a joint is torn from rest,
    its bristles still bent: drawn robots are passive."""
    for seed in range(5):
        friction = build_realistic(replace(OPTIONS, robot="arm7", seed=seed)).friction
        rng = np.random.default_rng(seed)
        for velocity in np.exp(rng.uniform(np.log(1e-4), np.log(3.0), (200, 1))) * rng.choice([-1.0, 1.0], (200, 7)):
            dry = friction.sliding(velocity)
            z = rng.uniform(-1.0, 1.0, 7) * friction.sliding(np.zeros(7)) / friction.stiffness
            rate = velocity - np.abs(velocity) * friction.stiffness * z / dry
            assert (friction.force(z, velocity, dry) * velocity - friction.stiffness * z * rate >= -1e-12).all()


def test_the_equation_of_motion_is_pinocchios(tmp_path: Path) -> None:
    """Inverse dynamics of the true bodies, and the rotors, take what the motors give less what the friction eats."""
    options = replace(OPTIONS, hide=(Hidden("coulomb_friction", "joint2", 1.0), Hidden("spring", "joint3", 4.0)))
    result = simulate(tmp_path / "bag", options)
    truth = json.loads(result.truth.read_text())
    model = pin.buildModelFromXML(true_urdf(build_realistic(options).nominal.text, truth))
    changed = build_realistic(options)
    loop = control_loop(changed, options)
    rng = np.random.default_rng(0)
    rotor = [entry["parameters"]["inertia"] for entry in truth["standing"] if entry["effect"] == "rotor_inertia"]
    spring = truth["effects"][1]["parameters"]
    for half_step in (100, 900, 5000):
        loop.bend = rng.uniform(-5e-4, 5e-4, 3)  # type: ignore[attr-defined]
        position = loop.controller.setpoints.position[half_step] + 1e-3 * rng.standard_normal(3)
        velocity = loop.controller.setpoints.velocity[half_step] + 1e-2 * rng.standard_normal(3)
        acceleration = loop.acceleration(half_step, position, velocity)
        effort = loop.robot.effort()
        dry = changed.friction.sliding(velocity) + np.array([0.0, 1.0, 0.0])
        cold = 1.0 + np.array(truth["warm_up"]["excess"]) * np.exp(
            -0.5 * half_step * loop.step / truth["warm_up"]["time"]
        )
        bend = loop.bend  # type: ignore[attr-defined]
        eaten = changed.friction.force(bend, velocity, dry, cold)
        needed = pin.rnea(model, model.createData(), position, velocity, acceleration) + np.array(rotor) * acceleration
        needed += [0.0, 0.0, spring["stiffness"] * (position[2] - spring["equilibrium"])]
        np.testing.assert_allclose(needed, effort + unseen(truth, effort, position) - eaten, atol=1e-7)


def unseen(truth: dict[str, Any], effort: FloatArray, position: FloatArray) -> FloatArray:
    """Cogging and ripple by the truth file."""
    motors = {name: np.array(values) for name, values in truth["motors"].items()}
    waves = np.sin(motors["cycles"] * position + motors["phase"]) * motors["cogging"]
    return (
        waves[0]
        + waves[1]
        + motors["ripple"] * effort * np.sin(2.0 * (motors["cycles"][0] * position + motors["phase"][0]))
    )


def test_a_seed_gives_the_same_messages_and_another_motion_the_same_robot(tmp_path: Path) -> None:
    once, again = (recorded(simulate(tmp_path / name, OPTIONS).bag) for name in ("once", "again"))
    assert [(item.time, item.raw) for item in once] == [(item.time, item.raw) for item in again]
    other = build_realistic(replace(OPTIONS, motion_seed=9, hide=(Hidden("payload", "joint3"),)))
    assert other.standing == robot().standing
    for part in ("friction", "motors", "sensors"):
        for mine, same in zip(vars(getattr(robot(), part)).values(), vars(getattr(other, part)).values(), strict=True):
            np.testing.assert_array_equal(mine, same)
    assert [body.mass for body in other.bodies] == [body.mass for body in robot().bodies]
    assert build_realistic(replace(OPTIONS, seed=5)).friction.level[0] != robot().friction.level[0]


def test_messages_are_as_declared(tmp_path: Path) -> None:
    options = replace(OPTIONS, duration=8.0)
    result = simulate(tmp_path / "bag", options)
    truth = json.loads(result.truth.read_text())
    states = messages(result.bag, "/joint_states")
    sensors, order = truth["sensors"], [truth["joints"].index(name) for name in states[0].name]
    assert result.samples == len(states) < options.samples
    for column, step in (("position", sensors["encoder"]), ("effort", sensors["effort_step"])):
        ticks = np.array([getattr(message, column) for message in states]) / np.array(step)[order]
        np.testing.assert_allclose(ticks, np.round(ticks), atol=1e-6)
    stamps = np.array([message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec for message in states])
    late = stamps - stamps[0].round() - np.round((stamps - stamps[0].round()) * options.rate) / options.rate
    assert float(late.std()) == pytest.approx(sensors["jitter"], rel=0.1)
    assert (np.diff(stamps) > 0.0).all()


def test_losses_have_their_share_and_length() -> None:
    arrives = arrival_mask(200_000, 0.02, 3.0, np.random.default_rng(1))
    starts = int(np.sum(arrives[:-1] & ~arrives[1:]))
    assert 1.0 - arrives.mean() == pytest.approx(0.02, rel=0.1)
    assert float(np.sum(~arrives)) / starts == pytest.approx(3.0, rel=0.1)


def test_inertias_are_possible_and_off_by_what_cad_is() -> None:
    distances = []
    for seed in range(10):
        each = build_realistic(replace(OPTIONS, seed=seed))
        for true, told in zip(each.bodies, each.nominal.inertias, strict=True):
            moments = np.linalg.eigvalsh(true.inertia)
            assert true.mass > 0.0 < moments[0]
            assert moments[2] < moments[0] + moments[1]
            distances.append(np.log(true.mass / told.mass))
    assert 0.1 < np.std(distances) < 0.3


def test_a_hidden_link_mass_changes_one_link() -> None:
    link = robot().bodies[-1]
    changed = build_realistic(replace(OPTIONS, hide=(Hidden(LINK_MASS, link.name, 0.7),)))
    assert changed.bodies[-1].mass == pytest.approx(0.7 * link.mass)
    np.testing.assert_allclose(changed.bodies[-1].inertia, 0.7 * link.inertia)
    assert [body.mass for body in changed.bodies[:-1]] == [body.mass for body in robot().bodies[:-1]]
    assert [effect.name for effect in changed.hidden] == [LINK_MASS]


@pytest.mark.parametrize(
    ("hidden", "message"),
    [
        (Hidden("backlash", "joint2"), "leave out --realistic"),
        (Hidden(LINK_MASS, "nowhere", 1.2), "moving link with a mass"),
        (Hidden(LINK_MASS, "link2"), "needs a factor above 0"),
    ],
)
def test_what_cannot_be_hidden_is_refused(hidden: Hidden, message: str) -> None:
    with pytest.raises(InputError, match=message):
        build_realistic(replace(OPTIONS, hide=(hidden,)))
