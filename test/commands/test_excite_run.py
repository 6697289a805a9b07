"""``geomid excite run`` before it has anything to do with a robot; with one: test/ros/test_excite_run.py."""

from __future__ import annotations

from pathlib import Path

import click
import pytest

from geomid_ros.commands.excite.learn import learn
from geomid_ros.commands.excite.run import run

from .running import done, refused
from .test_help import LIBRARIES, loaded


@pytest.mark.parametrize("command", [run, learn], ids=["run", "learn"])
def test_help_explains_every_option_and_loads_no_library(command: click.Command) -> None:
    text = done("excite", str(command.name), "--help")
    options = [parameter for parameter in command.params if isinstance(parameter, click.Option)]
    assert len(options) > 5
    for option in options:
        assert option.opts[0] in text
        assert (option.help or "").endswith((".", "]"))
    assert not loaded(("excite", str(command.name), "--help")) & LIBRARIES


def test_files_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    pytest.importorskip("rclpy")
    assert "motion.yaml: the trajectory cannot be read" in refused("excite", "run", tmp_path / "motion.yaml")
    message = refused("excite", "run", tmp_path / "motion.yaml", "--urdf", tmp_path / "robot.urdf")
    assert "robot.urdf: the robot description cannot be read" in message


def test_who_learns_needs_a_robot() -> None:
    assert "no robot is given: add --urdf" in refused("excite", "learn")
