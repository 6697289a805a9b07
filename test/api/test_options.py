"""The Python door has the options of the command line: the same names, the same defaults, the same effect."""

from __future__ import annotations

import inspect
import json
import math
import re
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from files.recordings import BAGS

import geomid_ros
from geomid_ros.api.robot import configuration
from geomid_ros.commands import root
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.options import (
    ComparedResults,
    ExportOptions,
    IdentifyOptions,
    MotionOptions,
    PayloadOptions,
    RecordingOptions,
    RobotOptions,
)

BAG, URDF = BAGS / "arm3", BAGS / "arm3.urdf"
# What a command does with a result, which in Python are the result's methods; and what a function alone is told.
OF_COMMANDS = {"out", "report", "as_json", "controller", "until", "help"}
OF_FUNCTIONS = {"progress"}
DOORS: dict[str, Callable[..., Any]] = {
    "compare": geomid_ros.compare,
    "excite": geomid_ros.excite,
    "export": geomid_ros.export,
    "fleet": geomid_ros.identify_fleet,
    "gap": geomid_ros.find_gap,
    "identify": geomid_ros.identify,
    "payload": geomid_ros.weigh_payload,
    "report": geomid_ros.rebuild_report,
    "sample": geomid_ros.sample,
    "verify": geomid_ros.verify,
}


def keywords(function: Callable[..., Any]) -> dict[str, Any]:
    """All arguments of a function with their defaults."""
    return {name: parameter.default for name, parameter in inspect.signature(function).parameters.items()}


def options(name: str) -> dict[str, Any]:
    """The arguments and options of a command with their defaults."""
    command = root.get_command(click.Context(root), name)
    assert command is not None
    given = {str(parameter.name): parameter.get_default(click.Context(command)) for parameter in command.params}
    return {name: value if isinstance(value, bool | float | int | str) else None for name, value in given.items()}


@pytest.mark.parametrize("name", DOORS)
def test_a_function_has_the_arguments_of_its_command_explained_and_with_their_defaults(name: str) -> None:
    """Where both have one; several of nothing is nothing."""
    there, here = keywords(DOORS[name]), options(name)
    assert there.keys() - OF_FUNCTIONS - OF_COMMANDS == here.keys() - OF_COMMANDS
    for option, default in here.items():
        if option in there and there[option] is not inspect.Parameter.empty:
            assert (default or None) == (there[option] or None), option
    told = set(re.findall(r"^    (\w+): \w", inspect.getdoc(DOORS[name]) or "", re.MULTILINE))
    assert told >= there.keys()


def test_keywords_are_parameters_and_win_over_the_configuration(tmp_path: Path) -> None:
    """In whichever way that is given."""
    config = {"filter.cutoff": 3.0, "gravity": [0.0, 0.0, -9.7], "still_speed": 0.01}
    gains, gravity = [2.0, "joint2=0.5"], (0.0, 0.0, -9.8)
    chosen = RobotOptions(config=config, cutoff=8.0, gravity=gravity, gain=gains, lock="joint3", merge=True)
    found = configuration(chosen, floating_base=True)
    assert found.given_values == {
        "filter.cutoff": 8.0,
        "gravity": [0.0, 0.0, -9.8],
        "effort_gain": 2.0,
        "joint.joint2.effort_gain": 0.5,
        "locked_joints": ["joint3"],
        "merge_joint_states": True,
        "floating_base": True,
        "still_speed": 0.01,
    }
    (tmp_path / "node.yaml").write_text(json.dumps({"/**": {"ros__parameters": config}}))
    for same in (tmp_path / "node.yaml", str(tmp_path / "node.yaml"), Configuration(config)):
        assert configuration(replace(chosen, config=same), floating_base=True).given_values == found.given_values


def test_names_are_separated_by_commas_as_on_the_command_line_and_none_is_the_default() -> None:
    """For a script that hands its own options on."""
    options = IdentifyOptions(BAG, links="link2, link3", effects="none", candidates="none")
    assert (options.links, options.effects, options.candidates) == (["link2", "link3"], [], [])
    given = [each for each in fields(IdentifyOptions) if each.name != "bags"]
    assert vars(IdentifyOptions(BAG, **{each.name: None for each in given})) == vars(IdentifyOptions(BAG))


def test_a_folder_stands_for_the_result_in_it(tmp_path: Path) -> None:
    assert RecordingOptions(model=tmp_path).model == tmp_path
    (tmp_path / "estimate.json").touch()
    for given in (tmp_path, str(tmp_path), tmp_path / "estimate.json"):
        assert Path(str(RecordingOptions(model=given).model)) == tmp_path / "estimate.json"
        assert ComparedResults(given, "robot.urdf").first == ExportOptions(given, "ur").model


def test_numbers_of_numpy_are_numbers() -> None:
    own = {"filter.cutoff": 8.0, "gravity": [0.0, 0.0, -9.75], "effort_gain": 2.0, "floating_base": True}
    gravity = [*np.array([0.0, 0.0, -9.75])]
    chosen = RobotOptions(cutoff=np.float64(8.0), gravity=gravity, gain=np.float32(2.0), floating_base=np.bool_(True))
    assert configuration(chosen).given_values == own
    start = np.array([0.3, 0.4, 0.5])
    motion = geomid_ros.excite(URDF, duration=np.int64(4), repeats=1, start=start, collision=False)
    np.testing.assert_allclose(motion.trajectory.positions[0], start, atol=1e-9)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"gain": "fast"}, r"gain: 'fast' is not of the form \[JOINT=\]FACTOR"),
        ({"gain": [1.0, 1.0, 2.0]}, "gain: all joints given more than once; for each joint its own: {'JOINT': 2.0"),
        ({"gain": np.ones(2)}, "gain: all joints given more than once"),
        ({"gain": {"joint1": "fast"}}, "gain: 'joint1=fast' is not of the form"),
        ({"hold_out": "0.3"}, "hold_out is '0.3', expected a number"),
        ({"cut_off": 3.0}, "unknown argument 'cut_off'. Did you mean 'cutoff'"),
        ({"urdf": URDF, "bags": BAG}, "identify: multiple values for argument 'bags'"),
        ({"bags": None}, "bags is missing"),
        ({"bags": np.zeros(3)}, r"0\.0\S* is not a path"),
        ({"bags": BAG, "links": "link2,,link3"}, "links: the text is empty"),
    ],
)
def test_a_wrong_argument_is_named(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(geomid_ros.InputError, match=said):
        geomid_ros.identify(*([] if "bags" in wrong and "urdf" not in wrong else [BAG]), **{"urdf": URDF} | wrong)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"duration": 1.9}, "duration is 1.9, expected 2 <= duration <= 600"),
        ({"repeats": 2.5}, "repeats is 2.5, expected a whole number"),
        ({"repeats": 0}, "repeats is 0, expected 1 <= repeats <= 20"),
        ({"speed": 0.0}, "speed is 0, expected 0 < speed <= 1"),
        ({"clearance": -1.0}, "clearance is -1, expected 0 <= clearance$"),
        ({"clearance": math.nan}, "clearance is nan"),
    ],
)
def test_a_number_out_of_its_range_is_refused(wrong: dict[str, Any], said: str) -> None:
    """The ends of a range belong to it unless they are open."""
    with pytest.raises(geomid_ros.InputError, match=said):
        geomid_ros.excite(URDF, **wrong)
    assert MotionOptions(duration=2.0, speed=1.0, clearance=0.0).duration == 2.0
    PayloadOptions(BAG, BAG, gain_std=0.0)
    with pytest.raises(geomid_ros.InputError, match="gain_std is 1, expected 0 <= gain_std < 1"):
        PayloadOptions(BAG, BAG, gain_std=1.0)
