"""``import geomid_ros``: what it offers, that it loads nothing, and that the lines of its page do what they say."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from contextlib import chdir
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from files.recordings import BAGS, QUICK

import geomid_ros
from geomid_ros.simulation.options import Hidden, SimulationOptions
from geomid_ros.simulation.recording import simulate

ROOT = Path(__file__).parents[2]
LEVEL = 1.0  # of the friction that is hidden at joint2 [N m]


def test_the_import_loads_nothing_else() -> None:
    script = "import sys; import geomid_ros; print(*(name for name in sys.modules if '.' not in name))"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout.split()
    assert "geomid_ros" in loaded
    assert set(loaded) <= {"geomid_ros", "__main__"} | set(sys.stdlib_module_names) | set(before()), loaded


@pytest.mark.parametrize(("chosen", "threads"), [({}, 1), ({"OPENBLAS_NUM_THREADS": "2"}, 2)])
def test_linear_algebra_has_one_thread_unless_the_user_wants_more(chosen: dict[str, str], threads: int) -> None:
    if (os.cpu_count() or 1) < 2:
        pytest.skip("one processor: there is one thread in any case")
    script = "import os, geomid_ros, numpy as np; np.ones((512, 512)) @ np.ones((512, 512)); print(os.listdir(TASKS))"
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"} | chosen
    command = [sys.executable, "-c", script.replace("TASKS", "'/proc/self/task'")]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert len(ast.literal_eval(run.stdout)) == threads


def before() -> list[str]:
    """What an interpreter has loaded before it runs anything: files of site-packages may."""
    script = "import sys; print(*(name for name in sys.modules if '.' not in name))"
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout.split()


def typed() -> dict[str, str]:
    """The names that a type checker sees, and the modules that it takes them from."""
    tree = ast.parse(Path(geomid_ros.__file__).read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    return {alias.name: str(node.module) for node in block.body for alias in getattr(node, "names", ())}


def test_every_name_is_what_a_type_checker_takes_it_for_and_there_are_no_others() -> None:
    for name in geomid_ros.__all__:
        value = getattr(geomid_ros, name)
        assert value is getattr(import_module(typed()[name]), name)
        assert value.__doc__
    assert typed().keys() == set(geomid_ros.__all__)
    assert set(dir(geomid_ros)) == {*geomid_ros.__all__, "__version__"}
    with pytest.raises(AttributeError, match="'geomid_ros' has no attribute 'indentify'"):
        _ = geomid_ros.indentify


def test_the_first_lines_of_the_page_find_and_name_friction_and_write_it(tmp_path: Path) -> None:
    """Of a small arm with friction at one joint."""
    pytest.importorskip("mujoco")
    (tmp_path / "robot.urdf").write_text((BAGS / "arm3.urdf").read_text())
    hidden = (Hidden("coulomb_friction", "joint2", LEVEL),)
    options = SimulationOptions(robot="arm3", seed=5, duration=12.0, longest_step=QUICK, hide=hidden)
    simulate(tmp_path / "my_bag", options)
    page = (ROOT / "docs/pages/use/library.md").read_text(encoding="utf-8")
    shown: dict[str, Any] = {}
    with chdir(tmp_path):
        exec(re.findall(r"```python\n(.*?)```", page, re.DOTALL)[0], shown)
    found, gap = shown["found"], shown["gap"]
    levels = {effect.joint: effect for effect in found.effects if effect.name == "coulomb_friction"}
    assert levels["joint2"].value == pytest.approx(LEVEL, rel=0.05)
    assert levels["joint1"].value < 0.05 * LEVEL
    assert found.rms.keys() == found.rms_nominal.keys() == {"joint1", "joint2", "joint3"}
    assert found.rms["joint2"] < 0.1 * found.rms_nominal["joint2"]
    assert gap.verdict == "named"
    assert (gap.findings[0].effect, gap.findings[0].joint) == ("coulomb_friction", "joint2")
    assert gap.findings[0].parameters["level"].value == pytest.approx(LEVEL, rel=0.05)
    assert gap.findings[0].sentence in repr(gap)
    tables = {"links.csv", "effects.csv", "channels.csv"}
    files = {"estimate.json", "identified.urdf", "effects.yaml", "posterior.npz", "identification.png", "report.html"}
    assert {path.name for path in (tmp_path / "geomid_out").iterdir()} == files | tables
    assert (tmp_path / "geomid_out/identified.urdf").read_text() == found.urdf()
    assert "Coulomb friction" in (tmp_path / "report.html").read_text()
