"""Stages for tests of this folder."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from .direct import Direct
    from .rig import Rig
    from .stage import Stage

if find_spec("rclpy") is None:
    collect_ignore_glob = ["*.py"]


@pytest.fixture(scope="session", autouse=True)
def forked() -> Iterator[None]:
    """Nothing that was started is left."""
    yield
    from .forked import end_server  # noqa: PLC0415

    end_server()


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    """A ROS domain for this test alone."""
    from .stage import staged  # noqa: PLC0415 needs ROS

    with staged(tmp_path) as stage:
        yield stage


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    """One node for many faults, one after the other: to start it takes longer than any of them, and while nobody needs
    it, it costs time."""
    from .rig import rigged  # noqa: PLC0415 needs ROS

    with rigged(tmp_path_factory.mktemp("rig")) as rig:
        yield rig


@pytest.fixture(scope="session")
def direct() -> Iterator[Direct]:
    """The same without ROS."""
    from .direct import Direct  # noqa: PLC0415 needs ROS

    with closing(Direct()) as direct:
        yield direct
