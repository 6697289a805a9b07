"""Play that the load crosses against a drag."""

import numpy as np
import pytest

from geomid_ros.model.effects.drive import CROSSINGS, sides


def square(period: float, seconds: float, size: float) -> np.ndarray:
    """A load of one size that changes its direction every second, ``(N, 1)``."""
    times = np.arange(round(seconds / period)) * period
    return size * np.where(np.floor(times) % 2 == 0, 1.0, -1.0)[:, None]


@pytest.mark.parametrize("size", [0.1, 30.0])
def test_the_usual_load_crosses_in_the_time_of_its_name(size: float) -> None:
    period = 1e-3
    side = sides(square(period, 4.0, size), period)[:, 0]
    for place, crossing in enumerate(CROSSINGS):
        changing = np.abs(side[:, place]) < 1.0 - 1e-9
        crossings = 3  # at 1, 2 and 3 s
        assert np.count_nonzero(changing) * period / crossings == pytest.approx(crossing, abs=1.1 * period)


def test_half_the_load_takes_twice_the_time() -> None:
    """Beside a second joint's load; each joint's is measured by its own usual size."""
    period, strong = 1e-3, square(1e-3, 4.0, 1.0)
    weak = np.where(np.arange(4000)[:, None] < 2000, strong, 0.5 * strong)
    place = len(CROSSINGS) - 1
    side = sides(np.hstack([strong, weak]), period)[:, :, place]
    strong_time, weak_time = (np.count_nonzero(np.abs(side[3000:, joint]) < 1.0) for joint in range(2))
    assert weak_time == pytest.approx(2.0 * np.sqrt((1.0 + 0.25) / 2.0) * strong_time, rel=0.02)


def test_the_load_holds_the_link_on_its_side() -> None:
    rng = np.random.default_rng(4)
    load = np.cumsum(rng.normal(size=(5000, 3)), axis=0)
    side = sides(load, 0.01)
    assert np.all(np.abs(side) <= 1.0)
    held = np.all(np.lib.stride_tricks.sliding_window_view(load > 0.3 * np.std(load, axis=0), 200, axis=0), axis=2)
    assert np.any(held)
    assert np.all(side[199:][held] == 1.0), "two seconds of load from one side are more than any crossing"
