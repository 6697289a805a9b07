"""For tests of commands."""

import pytest
from matplotlib.figure import Figure

from .running import undrawn


@pytest.fixture
def without_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where nobody looks at them; what a module shares is drawn nevertheless."""
    undrawn(monkeypatch)
    monkeypatch.setattr("geomid_ros.report.excitation.motion_figure", lambda *_: Figure((1.0, 1.0)))
