"""What can be asked to be hidden, that the seed decides the rest, and that a bag does not give it away."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from files.recordings import QUICK

from geomid_ros.errors import InputError
from geomid_ros.simulation.description import WRIST_FRAME, read_description, robot_description
from geomid_ros.simulation.effect_sizes import SIZES, chosen_effects
from geomid_ros.simulation.effects import TrueEffect
from geomid_ros.simulation.options import Hidden, SimulationOptions, parse_hidden
from geomid_ros.simulation.recording import simulate
from geomid_ros.types import FloatArray

from .reading import messages

OPTIONS = SimulationOptions(robot="arm7", wrench_frame=WRIST_FRAME, longest_step=QUICK)


def chosen(*hide: Hidden, seed: int = 1) -> tuple[TrueEffect, ...]:
    options = replace(OPTIONS, hide=hide, seed=seed)
    return chosen_effects(options, read_description(robot_description(options.robot)))


def test_how_it_is_written() -> None:
    for text, expected in {
        "spring": Hidden("spring"),
        "spring:joint2": Hidden("spring", "joint2"),
        "spring=20": Hidden("spring", "", 20.0),
        "spring:joint2=-2e1": Hidden("spring", "joint2", -20.0),
        "spring:joint2=stiffness=20,equilibrium=0.3": Hidden(
            "spring", "joint2", None, {"stiffness": 20.0, "equilibrium": 0.3}
        ),
    }.items():
        assert parse_hidden(text) == expected
    for text in ("spring=hard", "spring:joint1=stiffness=", "spring=nan", "spring=stiffness=1,2"):
        with pytest.raises(InputError, match="is not a number"):
            parse_hidden(text)


@pytest.mark.parametrize("effect", SIZES)
def test_the_seed_decides_what_is_left_open(effect: str) -> None:
    drawn = [chosen(Hidden(effect), seed=seed)[0] for seed in range(8)]
    assert drawn == [chosen(Hidden(effect), seed=seed)[0] for seed in range(8)]
    assert len({next(iter(each.parameters.values())) for each in drawn}) > 4
    if drawn[0].joint.startswith("joint"):
        assert len({each.joint for each in drawn}) > 1


def test_payload_by_joint_and_by_link() -> None:
    for place, link in (("joint7", "link7"), ("tool", "tool"), ("link7", "link7")):
        (payload,) = chosen(Hidden("payload", place))
        assert (payload.joint, payload.link) == ("joint7", link)


@pytest.mark.parametrize(
    ("hide", "message"),
    [
        ((Hidden("gravity_tilt", "joint1"),), "gravity_tilt is in the whole robot"),
        ((Hidden("wrench_offset", "joint1"),), "wrench_offset is at the topic /wrench"),
        ((Hidden("spring", "joint1"), Hidden("spring", "joint1")), "both requested at 'joint1'"),
        ((Hidden("backlash", "joint1"), Hidden("joint_elasticity", "joint1")), "both requested at 'joint1'"),
        ((Hidden("coulomb_friction", "joint1", -1.0),), "level is -1; it must be above 0"),
        ((Hidden("payload", "tool", 0.0),), "mass is 0; it must be above 0"),
    ],
)
def test_what_cannot_be_hidden(hide: tuple[Hidden, ...], message: str) -> None:
    with pytest.raises(InputError, match=message):
        chosen(*hide)


def columns(of: list[Any], name: str) -> FloatArray:
    return np.array([getattr(message, name) for message in of])


def test_commands_and_gains_are_the_whole_controller(tmp_path: Path) -> None:
    """Feed-forward plus gains times errors is the effort that acted."""
    pytest.importorskip("mujoco")
    options = replace(OPTIONS, duration=3.0, hide=(Hidden("coulomb_friction"),), commands=True)
    silent = dict.fromkeys(("position_noise", "velocity_noise", "effort_noise", "force_noise", "torque_noise"), 0.0)
    result = simulate(tmp_path / "recording", replace(options, **silent))
    states, commands = (messages(result.bag, topic) for topic in ("/joint_states", "/joint_commands"))
    assert result.controller is not None
    gains = yaml.safe_load(result.controller.read_text())["joint_trajectory_controller"]["ros__parameters"]["gains"]
    p, d = (np.array([gains[name][key] for name in states[0].name]) for key in ("p", "d"))
    errors = [columns(commands, name) - columns(states, name) for name in ("position", "velocity")]
    wanted = columns(commands, "effort") + p * errors[0] + d * errors[1]
    assert commands[0].name == states[0].name
    assert np.abs(errors[0]).max() > 1e-4
    np.testing.assert_allclose(wanted, columns(states, "effort"), rtol=0.0, atol=1e-9)
