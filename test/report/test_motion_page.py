"""The page that plays a motion: what is drawn is where the robot is, names are escaped, and the script runs."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import pinocchio as pin
import pytest
from excitation.arm import small_task, urdf
from scipy.spatial import ConvexHull

from geomid_ros.errors import GeomidError
from geomid_ros.report.excitation import corners, save, write_motion_page
from geomid_ros.session.excitation import Excitation, design
from geomid_ros.session.options import MotionOptions

from .pages import EVIL, Page, lines_of_script

AVOID = ("plane:0,0,1,-0.2", "box:0.9,0,0.7,0.2,2,2")


def designed(text: str | None = None, avoid: tuple[str, ...] = AVOID) -> Excitation:
    wish = MotionOptions(duration=6.0, repeats=2, avoid=avoid, collision=bool(avoid))
    return design(small_task(wish, text), wish)


@pytest.fixture(scope="module")
def found() -> Excitation:
    return designed()


def written(found: Excitation, folder: Path) -> tuple[str, dict[str, Any]]:
    write_motion_page(folder / "motion.html", found)
    text = (folder / "motion.html").read_text(encoding="utf-8")
    (data,) = re.findall(r'<script type="application/json" id="motion">(.*?)</script>', text, re.DOTALL)
    scene: dict[str, Any] = json.loads(data)
    return text, scene


def test_bodies_are_where_pinocchio_has_them_and_what_is_avoided_where_it_is(found: Excitation, tmp_path: Path) -> None:
    _, scene = written(found, tmp_path)
    model = pin.buildModelFromXML(urdf())
    data = model.createData()
    times = np.arange(len(scene["positions"])) / scene["rate"]
    assert times[-1] == pytest.approx(3.0)
    positions = found.motion.at(times)[0]
    np.testing.assert_allclose(scene["positions"], positions, atol=1e-4)
    for index, q in enumerate(positions):
        pin.framesForwardKinematics(model, data, q)
        for place, link in enumerate(("base", "turret", "upper", "fore")):
            own = data.oMf[model.getFrameId(link)]
            np.testing.assert_allclose(scene["origins"][index][place], own.translation, atol=1e-4)
            np.testing.assert_allclose(np.reshape(scene["turns"][index][place], (3, 3)), own.rotation, atol=1e-4)
    assert scene["above"] == [-1, 0, 1, 2]
    fore = np.array(scene["bodies"][3][0])
    np.testing.assert_allclose(sorted(map(tuple, np.abs(fore - [0.0, 0.0, 0.2]))), [(0.03, 0.03, 0.2)] * 8)
    plane, box = map(np.array, scene["around"])
    np.testing.assert_allclose(plane[:, 2], -0.2)
    assert len(ConvexHull(plane[:, :2]).vertices) == 4
    np.testing.assert_allclose([box.min(axis=0), box.max(axis=0)], [[0.8, -1.0, -0.3], [1.0, 1.0, 1.7]])


def test_corners_are_the_farthest_points_of_a_shape() -> None:
    points = np.random.default_rng(0).standard_normal((5000, 3))
    few = corners(points)
    assert 20 < len(few) <= 80
    hull = {tuple(point) for point in points[ConvexHull(points).vertices].round(4)}
    assert {tuple(point) for point in few} <= hull


def test_names_are_escaped_and_nothing_is_loaded(tmp_path: Path) -> None:
    named = urdf()
    for evil, joint, link in zip(EVIL, ("j1", "j2", "j3"), ("turret", "upper", "fore"), strict=True):
        for own in (joint, link):
            named = named.replace(f'"{own}"', quoteattr(evil, {'"': "&quot;"}))
    text, _ = written(designed(named, avoid=()), tmp_path)
    page = Page(text)
    for evil in EVIL:
        assert " ".join(evil.split()) in page.text
    page.is_alone()
    assert len(text) < 100_000


def test_the_script_plays_what_the_page_has(found: Excitation, tmp_path: Path) -> None:
    _, scene = written(found, tmp_path)
    lines = lines_of_script("motion.js", STAGE.replace("MOTION", json.dumps(json.dumps(scene))), tmp_path)
    assert lines[:3] == ["0.0 of 6.0 s", "1.3 of 6.0 s Pause", "4.5 of 6.0 s Play"]
    # The second period is as the first one.
    middle = found.motion.at(np.array([1.5]))[0, 0]
    np.testing.assert_allclose([float(value) for value in lines[3].split()], middle, atol=0.02)
    low, high = found.task.feasibility.limits.position.T
    shown = [float(value.rstrip("%")) for value in lines[4].split()]
    np.testing.assert_allclose(shown, 100.0 * (middle - low) / (high - low), atol=1.0)
    # Every body and obstacle is one outline, every link but the first one line; to turn it draws other points.
    assert lines[5] == f"{4 + 2} filled, {3} lines"
    assert lines[6] == "turned true"


STAGE = """
const told = {};
const element = (extra) => Object.assign({ style: {}, textContent: "", value: "0",
  addEventListener(name, call) { (told[extra.id] ??= {})[name] = call; }, setPointerCapture() {} }, extra);
let drawn = [];
const context = { beginPath() { drawn.push([]); }, closePath() {}, moveTo(x, y) { drawn.at(-1).push([x, y]); },
  lineTo(x, y) { drawn.at(-1).push([x, y]); }, fill() { drawn.at(-1).filled = true; }, stroke() {} };
const sheet = element({ id: "canvas", clientWidth: 400, clientHeight: 300, getContext: () => context });
const parts = { canvas: sheet, "button.play": element({ id: "button" }), input: element({ id: "slider" }),
  "output.clock": element({ id: "clock" }) };
const dots = [1, 2, 3].map(() => element({})), texts = [1, 2, 3].map(() => element({}));
let frame = null;
globalThis.window = element({ id: "window", devicePixelRatio: 2 });
globalThis.getComputedStyle = () => ({ getPropertyValue: () => "#000" });
globalThis.requestAnimationFrame = (call) => { frame = call; };
globalThis.document = { getElementById: () => ({ textContent: MOTION }), querySelector: (name) => parts[name],
  querySelectorAll: (name) => (name.includes("output") ? texts : dots) };
SCRIPT
console.log(clock.textContent);
told.button.click();
frame(1000); frame(2250);
console.log(clock.textContent, button.textContent);
slider.value = "0.75";
told.slider.input();
console.log(clock.textContent, button.textContent);
console.log(values.map((value) => value.textContent).join(" "));
console.log(marks.map((mark) => mark.style.left).join(" "));
drawn = []; draw();
const unturned = JSON.stringify(drawn);
const filled = drawn.filter((path) => path.filled).length;
console.log(`${filled} filled, ${drawn.length - filled} lines`);
told.canvas.pointerdown({ clientX: 0, clientY: 0, pointerId: 1 });
drawn = [];
told.canvas.pointermove({ clientX: 50, clientY: 0 });
console.log("turned", JSON.stringify(drawn) !== unturned);
"""


def test_a_folder_that_cannot_be_made_is_named(found: Excitation, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(GeomidError, match=f"{tmp_path}/file/motion: cannot be written"):
        save(found, tmp_path / "file" / "motion")
