"""What the package ships is found beside the sources and where ROS or pip installed it."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

import geomid_ros
from geomid_ros.commands.demo import shared_file
from geomid_ros.errors import InputError

ROOT = Path(__file__).parents[2]


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package without its sources, in a prefix after another one."""
    monkeypatch.setattr(geomid_ros, "__file__", str(tmp_path / "lib/geomid_ros/__init__.py"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(["", str(tmp_path / "other"), str(tmp_path / "prefix")]))
    file = tmp_path / "prefix/share/geomid_ros/bags/arm7.urdf"
    file.parent.mkdir(parents=True)
    file.touch()
    return file


def test_beside_the_sources() -> None:
    assert shared_file("bags/arm7.urdf").read_text() == (ROOT / "bags/arm7.urdf").read_text()
    assert shared_file("bags/arm7").is_dir()


def test_where_ros_installed_it(installed: Path) -> None:
    assert shared_file("bags/arm7.urdf") == installed


def test_where_pip_installed_it(installed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    monkeypatch.setattr(sys, "prefix", str(installed.parents[3]))
    assert shared_file("bags/arm7.urdf") == installed


def test_what_is_nowhere_is_answered_with_where_it_was_looked_for(installed: Path) -> None:
    with pytest.raises(InputError, match=r"bags/arm8 is not installed; looked in .*other/share/geomid_ros, .*prefix"):
        shared_file("bags/arm8")
    assert installed.exists()
