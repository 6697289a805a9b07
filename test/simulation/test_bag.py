"""What a recording holds, and that it depends on the seed and on nothing else.

The bags in `bags/` are what their recipe makes.
"""

from __future__ import annotations

import json
import runpy
from binascii import crc32
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from files.recordings import chunks, recorded, with_checksums

from geomid_ros.simulation.description import WRIST_FRAME
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.recording import SimulationResult, simulate
from geomid_ros.types import FloatArray

from .reading import messages

pytest.importorskip("mujoco")

OPTIONS = SimulationOptions(robot="arm3", duration=2.0, wrench_frame=WRIST_FRAME)


def numbers(value: Any) -> Iterator[float]:
    """Every number inside a JSON value."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        for entry in value:
            yield from numbers(entry)
    elif isinstance(value, float):
        yield value


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> SimulationResult:
    return simulate(tmp_path_factory.mktemp("bags") / "arm", OPTIONS)


def test_bag_carries_no_truth(result: SimulationResult) -> None:
    truth = json.loads(result.truth.read_text())
    planted = {value for value in numbers([truth["links"], truth["effects"]]) if value != 0.0}
    description = messages(result.bag, "/robot_description")[0].data
    content = b"".join(item.raw[1] for item in recorded(result.bag))
    assert len(planted) > 40
    for value in planted:
        assert repr(value) not in description
        assert np.float64(value).tobytes() not in content
    assert sorted(path.name for path in result.bag.iterdir()) == ["arm.mcap", "metadata.yaml"]


def test_noise_is_as_large_as_the_truth_says(result: SimulationResult, tmp_path: Path) -> None:
    silent = replace(OPTIONS, position_noise=0.0, velocity_noise=0.0, effort_noise=0.0)
    truth = json.loads(result.truth.read_text())
    bags = [messages(bag, "/joint_states") for bag in (result.bag, simulate(tmp_path / "arm", silent).bag)]
    order = [truth["joints"].index(name) for name in bags[0][0].name]
    for channel in ("position", "velocity", "effort"):
        loud, still = (np.array([getattr(message, channel) for message in bag]) for bag in bags)
        np.testing.assert_allclose((loud - still).std(0), np.array(truth["noise"][channel])[order], rtol=0.2)


def test_every_checksum_is_there(result: SimulationResult) -> None:
    """Of chunks, data section and summary, which rosbags leaves at zero; made again as the format says."""
    zstd = pytest.importorskip("backports.zstd")
    (path,) = result.bag.glob("*.mcap")
    data = path.read_bytes()
    assert with_checksums(data, zstd.decompress) == data
    assert list(chunks(data))
    data_end = data.rindex(b"\x0f\x04\0\0\0\0\0\0\0")
    assert data[data_end + 9 : data_end + 13] == crc32(data[:data_end]).to_bytes(4, "little") != bytes(4)
    assert data[-12:-8] == crc32(data[data_end + 13 : -12]).to_bytes(4, "little") != bytes(4)


BAGS = Path(__file__).parents[2] / "bags"
OTHER_MACHINE = 1e-6  # rad, rad/s, N, N m: other versions of the libraries round otherwise


RECIPES: dict[str, SimulationOptions] = runpy.run_path(str(BAGS / "make_bags.py"))["RECIPES"]


def numbers_of(bag: Path) -> tuple[FloatArray, FloatArray]:
    """Of joint states and of wrenches."""
    states = [[state.position, state.velocity, state.effort] for state in messages(bag, "/joint_states")]
    parts = [(message.wrench.force, message.wrench.torque) for message in messages(bag, "/wrench")]
    return np.array(states), np.array([[getattr(part, axis) for part in each for axis in "xyz"] for each in parts])


def test_recipe_gives_the_same_bag(tmp_path: Path) -> None:
    """Of the shorter one."""
    shipped, made = BAGS / "arm3", simulate(tmp_path / "arm3", RECIPES["arm3"]).bag
    assert messages(shipped, "/joint_states")[0].name == messages(made, "/joint_states")[0].name
    for ours, theirs in zip(numbers_of(shipped), numbers_of(made), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=OTHER_MACHINE)


def test_recipe_gives_the_same_robot(tmp_path: Path) -> None:
    """Of the longer one, in less time."""
    made = json.loads(simulate(tmp_path / "arm7", replace(RECIPES["arm7"], duration=2.0)).truth.read_text())
    shipped = json.loads((BAGS / "arm7.truth.json").read_text())
    for key in ("links", "effects", "noise"):
        assert [*numbers(made[key])] == pytest.approx([*numbers(shipped[key])], rel=1e-9), key
