"""For tests of commands."""

from functools import partial
from pathlib import Path

import pytest

from geomid_ros.estimation.estimator import EstimatorSettings

from .running import WRIST, done, identify, undrawn


def identified(folder: Path, *sensor: str) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        undrawn(patch)
        (folder / "printed").write_text(done(*identify("arm3", *sensor, "--out", folder)))
    return folder


@pytest.fixture(scope="session")
def wrist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of the small arm with the sensor at its wrist, and what was ``printed``: for tests that only read."""
    return identified(tmp_path_factory.mktemp("wrist"), *WRIST)


@pytest.fixture(scope="session")
def torques(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same without the sensor."""
    return identified(tmp_path_factory.mktemp("torques"))


@pytest.fixture
def in_a_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no minimum is needed."""
    monkeypatch.setattr("geomid_ros.session.configuration.EstimatorSettings", partial(EstimatorSettings, max_steps=1))
