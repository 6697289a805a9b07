"""The picture of an identification: a whole PNG or none, whatever the bodies and channels."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import proj3d

from geomid_ros.report import pictures
from geomid_ros.report.drawing import BodyDrawing, identification_figure
from geomid_ros.report.page import ticks
from geomid_ros.report.pictures import Ellipsoid, write_picture
from geomid_ros.report.series import Series

POINT = Ellipsoid(np.zeros(3), np.zeros(3), np.eye(3), 0.0)
NOWHERE = Ellipsoid(np.full(3, np.nan), np.full(3, np.nan), np.eye(3), np.nan)


def chain(length: int) -> list[BodyDrawing]:
    """Links of 0.3 m, one above the other."""
    bodies = []
    for k in range(length):
        origin = np.array([0.02 * k, 0.0, 0.3 * k])
        prior = Ellipsoid(origin + np.array([0.0, 0.0, 0.15]), np.array([0.05, 0.06, 0.16]), np.eye(3), 2.0)
        identified = replace(prior, centre=prior.centre + 0.01, mass=2.2)
        parent = bodies[-1].origin if bodies else None
        bodies.append(BodyDrawing(f"link{k}", origin, parent, prior, identified, k / length))
    return bodies


def channel(name: str, error: float = 0.1, samples: int = 300) -> Series:
    """A sine of amplitude 1; the URDF is off by 1, the identified model by ``error``."""
    times = 1.7e9 + 0.01 * np.arange(samples)
    truth = np.sin(0.05 * np.arange(samples))
    return Series(name, "N m", times, truth, truth + 1.0, truth + error)


def is_whole_picture(path: Path) -> bool:
    data = path.read_bytes()
    size = tuple(round(inches * pictures.DPI) for inches in pictures.SIZE)
    return data[:8] == b"\x89PNG\r\n\x1a\n" and struct.unpack(">II", data[16:24]) == size and b"IEND" in data[-12:]


def drawn(bodies: list[BodyDrawing], series: list[Series]) -> Figure:
    """The figure behind the picture."""
    return identification_figure("title", bodies, series, "note")


def texts(figure: Figure) -> list[str]:
    return [t.get_text() for t in figure.texts] + [t.get_text() for axes in figure.axes for t in axes.texts]


AWKWARD = {
    "more than the table has": (chain(31), [channel("joint")]),
    "nothing": ([], []),
    "a point": ([BodyDrawing("p", np.zeros(3), None, POINT, POINT, 0.0)], [channel("joint")]),
    "no numbers": ([BodyDrawing("p", np.zeros(3), None, NOWHERE, NOWHERE, np.nan)], [channel("short", samples=1)]),
    "constant": (chain(2), [Series("x", "N", np.arange(5.0), *(3 * [np.zeros(5)]))]),
    "names like formulas": ([replace(chain(1)[0], name="$a_{b$ $" + 40 * "x")], [channel("$x_{$")]),
}


@pytest.mark.parametrize("name", AWKWARD)
@pytest.mark.filterwarnings("error")
def test_every_input_gives_a_whole_picture(name: str, tmp_path: Path) -> None:
    bodies, series = AWKWARD[name]
    write_picture(tmp_path / "p.png", identification_figure("title $", bodies, series, "note $ " * 200))
    assert is_whole_picture(tmp_path / "p.png")
    assert [file.name for file in tmp_path.iterdir()] == ["p.png"]


def test_the_most_improved_channels_are_shown_in_their_order() -> None:
    series = [channel(f"joint{k}", error) for k, error in enumerate(np.linspace(1.5, 0.1, 20))]
    figure = drawn(chain(1), series)
    panels = {a.get_title("left"): a.get_title("right") for a in figure.axes if a.get_title("left")}
    assert list(panels) == [f"joint{k} [N m]" for k in range(8, 20)]
    assert panels["joint19 [N m]"] == "RMS 1.00 → 0.100"
    assert any("fell in 13 of 20 channels, rose in 7; the 12 with" in text for text in texts(figure))


def test_table_has_name_masses_and_share() -> None:
    *others, last = chain(4)
    said = [text.strip() for text in texts(drawn([*others, replace(last, std_mass=0.31)], [channel("joint")]))]
    for expected in ("link3", "2.00", "2.20", "± 0.310", "75 %"):
        assert expected in said


def space(figure: Figure) -> Any:
    """The axes in which the robot is drawn."""
    return next(axes for axes in figure.axes if axes.name == "3d")


def test_huge_tiny_and_far_bodies_do_not_ruin_the_view(tmp_path: Path) -> None:
    """The robot takes as much of the picture as without them, and each has its number inside."""
    bodies = chain(6)
    for index, (size, far) in enumerate(((3.0, 0.0), (1e-5, 0.0), (0.1, 50.0))):
        body = bodies[index].identified
        changed = replace(body, semi_axes=np.full(3, size), centre=body.centre + far, mass=1000.0)
        bodies[index] = replace(bodies[index], identified=changed)
    usual, changed_figure = drawn(chain(6), []), drawn(bodies, [])
    spans = [np.ptp(space(figure).get_zlim()) for figure in (usual, changed_figure)]
    assert spans[1] < 1.2 * spans[0]
    robot = space(changed_figure)
    numbers = {text.get_text(): text.get_position_3d() for text in robot.texts}
    for number in "123456":
        for place, (low, high) in zip(
            numbers[number], (robot.get_xlim(), robot.get_ylim(), robot.get_zlim()), strict=True
        ):
            assert low <= place <= high
    write_picture(tmp_path / "p.png", changed_figure)
    assert is_whole_picture(tmp_path / "p.png")


def test_an_ellipsoid_is_drawn_as_large_as_it_is() -> None:
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    surface = Ellipsoid(np.array([1.0, 2.0, 3.0]), np.array([0.1, 0.2, 0.3]), turn, 1.0).surface
    np.testing.assert_allclose(np.ptp(surface.reshape(3, -1), axis=1), [0.4, 0.2, 0.6])
    offset = turn.T @ (surface.reshape(3, -1) - [[1.0], [2.0], [3.0]])
    np.testing.assert_allclose(np.sum((offset / [[0.1], [0.2], [0.3]]) ** 2, axis=0), 1.0)


@pytest.mark.parametrize("step", [(0.0, 0.0, 0.3), (0.3, 0.0, 0.0)])
def test_a_robot_is_larger_than_a_third_of_its_place_whatever_its_shape(step: tuple[float, ...]) -> None:
    bodies = [
        replace(
            body,
            origin=k * np.array(step),
            parent_origin=(k - 1) * np.array(step) if k else None,
            prior=replace(body.prior, centre=k * np.array(step), semi_axes=np.full(3, 0.05)),
            identified=replace(body.identified, centre=k * np.array(step), semi_axes=np.full(3, 0.05)),
        )
        for k, body in enumerate(chain(6))
    ]
    figure = drawn(bodies, [])
    FigureCanvasAgg(figure).draw()
    robot = space(figure)
    ends = np.array([body.origin for body in bodies])
    pixels = np.array([robot.transData.transform(proj3d.proj_transform(*end, robot.get_proj())[:2]) for end in ends])
    inches = np.ptp(pixels, axis=0) / pictures.DPI
    assert np.max(inches) > 0.5 * np.max(pictures.ROBOT[2:])
    assert np.all(inches < pictures.ROBOT[2:])


def test_what_is_said_on_the_picture() -> None:
    """Reasons for doubt below the title, a body that is too far to draw; and no text shows an escaped line end."""
    reasons = ["DOUBTFUL: the total link mass is 10.4 kg.", "DOUBTFUL: " + 60 * "and so on "]
    bodies = chain(3)
    bodies[1] = replace(bodies[1], identified=replace(bodies[1].identified, centre=np.array([7.0, 0.0, 0.3])))
    said = texts(identification_figure("title", bodies, [channel("joint")], 60 * "a note ", reasons))
    assert any(text.startswith(f"{reasons[0]} DOUBTFUL: and so on") for text in said)
    assert "Not shown: 2 identified, reaches 7.14 m from its link's frame." in said
    assert not any("\\n" in text or "\n" in text for text in said)
    assert not any("Not shown" in text for text in texts(drawn(chain(3), [])))


@pytest.mark.parametrize(("low", "high"), [(-0.4, 1.1), (-1.6, 0.9), (0.0, 4.58), (-300.0, -20.0), (1e-4, 2e-3)])
def test_ticks_are_equally_far_apart_within_the_ends_and_zero_has_no_sign(low: float, high: float) -> None:
    for most in (2, 5, 7):
        found = ticks(low, high, most)
        assert 1 <= len(found) <= most + 1
        assert low <= found[0] <= found[-1] <= high
        np.testing.assert_allclose(np.diff(found, 2), 0.0, atol=1e-9 * (high - low))
        assert "-0" not in [f"{value:g}" for value in found]
        assert not low <= 0.0 <= high or min(map(abs, found)) < 1e-12
