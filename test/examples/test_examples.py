"""Every example runs, and does what it says."""

from __future__ import annotations

import json
import os
import re
import runpy
import signal
import subprocess
import sys
from contextlib import chdir, redirect_stdout
from io import StringIO
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
NOISE = 0.01  # of the raw rows
SOON = 60.0  # [s]


def started(name: str, folder: Path, **environment: str) -> subprocess.Popen[str]:
    """An example that runs in a folder, with its output in ``folder/log``."""
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    with (folder / "log").open("w") as log:
        return subprocess.Popen(
            [sys.executable, str(EXAMPLES / name)],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": path, "PYTHONUNBUFFERED": "1", **environment},
            stdout=log,
            stderr=subprocess.STDOUT,
            text=True,
        )


def output(name: str, folder: Path) -> str:
    """What an example prints that ends by itself, in this process: it would import what is here already."""
    printed = StringIO()
    with chdir(folder), redirect_stdout(printed):
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    return printed.getvalue()


def test_every_example_is_run_here() -> None:
    text = Path(__file__).read_text(encoding="utf-8")
    scripts = sorted(path.name for path in EXAMPLES.glob("*.py"))
    assert len(scripts) >= 4
    assert all(f'"{name}"' in text for name in scripts), scripts


def test_identify(tmp_path: Path) -> None:
    text = output("identify.py", tmp_path)
    names = {path.name for path in (tmp_path / "geomid_out").iterdir()}
    assert names == {
        *("estimate.json", "identified.urdf", "effects.yaml", "posterior.npz", "identification.png", "report.html"),
        *("links.csv", "effects.csv", "channels.csv"),
    }
    truth = {link["name"]: link["mass"] for link in json.loads((ROOT / "bags/arm7.truth.json").read_text())["links"]}
    (mass, std) = map(float, re.findall(r"^wrist_ft weighs ([\d.]+) ± ([\d.]+) kg", text, re.MULTILINE)[0])
    assert abs(mass - truth["tool"]) < 5.0 * std
    assert len(re.findall(r": +([\d.]+) -> ([\d.]+)", text)) == 13


def test_gap(tmp_path: Path) -> None:
    """What it is sure of is hidden in the arm, at that joint."""
    text = output("gap.py", tmp_path)
    assert {"report.html", "gap.json", "estimate.json"} <= {path.name for path in (tmp_path / "geomid_gap").iterdir()}
    hidden = {(e["effect"], e["joint"]) for e in json.loads((ROOT / "bags/arm7.truth.json").read_text())["effects"]}
    sure = set(re.findall(r"^(\w+) (\w*): .* \(confident\)$", text, re.MULTILINE))
    assert len(sure) > 7
    assert sure <= hidden
    improved = [(float(before), float(after)) for before, after in re.findall(r": +([\d.]+) -> ([\d.]+)", text)]
    assert len(improved) == 7
    assert all(after < 0.5 * before for before, after in improved)


def test_own_effect(tmp_path: Path) -> None:
    """There is no drag in the arm, and it says how sure it is of that; files have the effect by its name. Whoever runs
    it has one effect more: it has a process of its own."""
    assert started("own_effect.py", tmp_path).wait(300) == 0, (tmp_path / "log").read_text()
    text = (tmp_path / "log").read_text()
    drags = re.findall(r"^(joint\d): drag ([+-][\d.]+) ± ([\d.]+) N m s\^2/rad\^2$", text, re.MULTILINE)
    assert len(drags) == 7
    assert all(abs(float(value)) < 4.0 * float(std) < 2.0 for _, value, std in drags)
    written = json.loads((tmp_path / "geomid_own/estimate.json").read_text())["effects"]
    assert [e["joint"] for e in written if e["name"] == "quadratic_drag"] == [joint for joint, *_ in drags]


def test_raw_rows(tmp_path: Path) -> None:
    text = output("raw_rows.py", tmp_path)
    assert "converged: True  rows set aside: 0" in text
    (left,) = re.findall(r"leave unexplained: ([\d.]+)", text)
    assert float(left) < 2.0 * NOISE


def test_live_subscriber(tmp_path: Path) -> None:
    """Over DDS, in a domain of its own: masses of all links arrive, and Ctrl-C ends it well."""
    pytest.importorskip("rclpy")
    from ros.stage import BAGS, description, staged  # noqa: PLC0415 needs ROS

    with staged(tmp_path) as stage:
        stage.node({"robot_description": description("arm3"), "solve_period": 0.2})
        listener = started("live_subscriber.py", tmp_path, ROS_DOMAIN_ID=str(stage.domain))
        try:
            stage.play(BAGS / "arm3", 4.0)
            log = tmp_path / "log"
            links = [f"link{number}: " for number in (1, 2, 3)]
            stage.observer.wait_for(lambda: all(link in log.read_text() for link in links), "masses of all links")
            listener.send_signal(signal.SIGINT)
            assert listener.wait(SOON) == 0, log.read_text()
        finally:
            listener.kill()
            listener.wait()
        assert "Traceback" not in log.read_text()
