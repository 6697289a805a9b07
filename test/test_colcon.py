"""The package as a ROS workspace sees it: built, sourced, run and tested by colcon, outside this tree."""

import os
import re
import shlex
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree

import pytest
import tree

import geomid_ros

ROOT = tree.ROOT
EXECUTABLES = ("geomid", "geomid_node", "geomid_feedforward")
QUICK = "test/test_launch.py"  # what `colcon test` runs here: every test runs without it anyway

pytest.importorskip("colcon_core", reason="colcon is not installed")
pytestmark = pytest.mark.skipif("COLCON" in os.environ, reason="colcon runs this test: it would build within a build")


def run(command: str, workspace: Path) -> str:
    """What a bash command printed; fails with its whole output."""
    result = subprocess.run(
        ["bash", "-c", command], cwd=workspace, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    assert result.returncode == 0, f"{command}\n{result.stdout}"
    return result.stdout


def colcon(arguments: str, workspace: Path) -> str:
    return run(f"{shlex.quote(sys.executable)} -m colcon {arguments}", workspace)


def contents(folder: Path) -> set[Path]:
    """The files below a folder, relative to it, compiled ones left out."""
    files = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return {path for path in files if "__pycache__" not in path.parts}


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace in which the files of this tree, as git sees them, have been built."""
    workspace = tmp_path_factory.mktemp("workspace")
    tree.copy(workspace / "src" / "geomid_ros")
    run(f"CC={tree.quick_compiler(workspace)} {shlex.quote(sys.executable)} -m colcon build", workspace)
    return workspace


def test_one_version() -> None:
    declared = ElementTree.parse(ROOT / "package.xml").findtext("version")
    assert declared == geomid_ros.__version__ == version("geomid_ros")


def test_the_package_is_installed_whole_and_its_command_line_runs(workspace: Path) -> None:
    """Folders without ``__init__.py`` and data that ``setup.py`` does not name would be missing."""
    share, source = workspace / "install/geomid_ros/share", workspace / "src/geomid_ros"
    for folder in ("config", "launch"):
        assert contents(share / "geomid_ros" / folder) == contents(source / folder)
    assert (share / "geomid_ros/package.xml").is_file()
    assert (share / "ament_index/resource_index/packages/geomid_ros").is_file()
    executables = workspace / "install/geomid_ros/lib/geomid_ros"
    assert {path.name for path in executables.iterdir()} == set(EXECUTABLES)
    assert all(os.access(executables / name, os.X_OK) for name in EXECUTABLES)
    where = shlex.quote("import geomid_ros; print(geomid_ros.__path__[0])")
    installed = Path(run(f". install/setup.bash && {shlex.quote(sys.executable)} -c {where}", workspace).strip())
    assert installed.is_relative_to(workspace / "install")
    assert contents(installed) == contents(source / "geomid_ros") | {Path("geometry/_native.abi3.so")}
    run(f". install/setup.bash && {executables}/geomid --help", workspace)


def test_colcon_test_passes(workspace: Path) -> None:
    colcon(f"test --pytest-args {QUICK}", workspace)
    summary = colcon("test-result --all", workspace)
    assert re.search(r"[1-9]\d* tests, 0 errors, 0 failures, 0 skipped", summary), summary
