"""A library that is not installed is named, with what installs it: a release of ROS has none from PyPI."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec

import pytest
from files.recordings import BAGS

SCRIPT = """
import sys
from importlib import import_module

class Refusal:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == {library!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Refusal())
sys.argv = {arguments!r}
import_module({module!r}).main()
"""


def said_without(library: str, module: str, *arguments: str) -> str:
    """The one line that a program says; fails unless it ends with status 2."""
    script = SCRIPT.format(library=library, arguments=[module, *arguments], module=module)
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False, timeout=300)
    assert result.returncode == 2, result.stderr
    (line,) = result.stderr.splitlines()
    return line


@pytest.mark.parametrize(
    ("library", "package"), [("rosbags", "rosbags"), ("backports", "backports.zstd"), ("pinocchio", "pin")]
)
def test_a_command_names_it(library: str, package: str) -> None:
    arguments = ("identify", str(BAGS / "arm3"), "--urdf", str(BAGS / "arm3.urdf"))
    said = said_without(library, "geomid_ros.commands.root", *arguments)
    assert said == f"Error: {library} is not installed: pip install {package}"


def test_the_node_names_it() -> None:
    said = said_without("rclpy", "geomid_ros.ros.main")
    assert said.startswith("geomid_node: rclpy is not installed: pip install 'ros-jazzy-rclpy[fastrtps]' ")


@pytest.mark.skipif(find_spec("rclpy") is None, reason="ROS is not installed")
def test_the_dashboard_names_it() -> None:
    said = said_without("tornado", "geomid_ros.commands.root", "dashboard")
    assert said == "Error: tornado is not installed: pip install tornado"
