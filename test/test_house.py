"""The house: which floor may import which, who may import what from outside, and what must not be needed."""

from __future__ import annotations

import ast
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "geomid_ros"
# A room is a folder or a module right under the package. What is not named here fails the first test.
FLOORS = {
    "errors": -1,
    "types": -1,
    "geometry": 0,
    "model": 1,
    "signals": 1,
    "estimation": 2,
    "gap": 3,
    "files": 4,
    "session": 4,
    "gap_session": 4,
    "resimulation": 4,
    "simulation": 4,
    "__main__": 5,
    "cli": 5,
    "commands": 5,
    "ros": 5,
}
# Names from outside, and the rooms in which alone they may be imported.
KEPT_IN = {"pinocchio": ("model",), "mujoco": ("simulation", "resimulation"), "rclpy": ("ros",)}
OWN_FILES = "import_module(f'{__name__}.{file}')"  # all in the folder of the package that says this
COMPUTED = "(computed)"  # a name that is known only when the program runs: the player's message types
ROS_SUFFIXES = ("_msgs", "_srvs", "_interfaces")


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}


def imported(path: Path) -> Iterator[tuple[str, bool]]:
    """Every name that a file imports, wherever it does so, and whether that is at once when the file is loaded."""
    tree = ast.parse(path.read_text(encoding="utf-8"), filename=str(path))
    later = {
        inner
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef)
        for inner in ast.walk(function)
    }
    for node in ast.walk(tree):
        at_once = node not in later
        if isinstance(node, ast.Import):
            yield from ((alias.name, at_once) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                yield whole if whole in MODULES else str(node.module), at_once
        elif isinstance(node, ast.Call) and ast.unparse(node) == OWN_FILES:
            own = [name for name, other in MODULES.items() if other.parent == path.parent and other != path]
            yield from ((name, True) for name in own)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("import_module", "__import__")):
            yield str(node.args[0].value) if isinstance(node.args[0], ast.Constant) else COMPUTED, at_once


@cache
def imports() -> dict[str, list[tuple[str, bool]]]:
    """What every module imports: see :func:`imported`."""
    return {name: list(imported(path)) for name, path in MODULES.items()}


def room(module: str) -> str:
    """The room of a module of the package; empty for the package itself."""
    return f"{module}.".split(".")[1]


def test_every_room_is_on_a_floor() -> None:
    assert {room(module) for module in MODULES} - {""} <= set(FLOORS)
    assert len(MODULES) > 30


@pytest.mark.parametrize("module", MODULES)
def test_a_room_imports_from_its_own_floor_and_lower_ones(module: str) -> None:
    own = FLOORS.get(room(module), -1)
    for name, _ in imports()[module]:
        if name.split(".")[0] == PACKAGE.name and room(name):
            assert name in MODULES, f"{module} imports {name}, which does not exist"
            assert FLOORS[room(name)] <= own, f"{module} on floor {own} imports {name}"


def test_there_are_no_circles() -> None:
    graph = {module: {name for name, _ in names if name in MODULES} for module, names in imports().items()}
    try:
        list(TopologicalSorter(graph).static_order())
    except CycleError as error:
        pytest.fail(f"a circle of imports: {' <- '.join(error.args[1])}")


@pytest.mark.parametrize("module", MODULES)
def test_what_comes_from_outside_stays_in_its_room(module: str) -> None:
    for name, at_once in imports()[module]:
        top = name.split(".")[0]
        keepers = ("ros",) if top.endswith(ROS_SUFFIXES) or top == COMPUTED else KEPT_IN.get(top)
        assert keepers is None or room(module) in keepers, f"{module} imports {name}"
        assert top != "mujoco" or not at_once, f"{module} imports mujoco before it is needed"


def test_the_simulator_shares_no_code_with_the_estimator() -> None:
    """Else a mistake on both sides of the comparison would go unseen."""
    for module, names in imports().items():
        if room(module) == "simulation":
            used = {room(name) for name, _ in names if name in MODULES}
            assert used <= {"simulation", "errors", "types"}, f"{module} imports from {used}"


def test_the_lower_floors_need_neither_ros_nor_mujoco() -> None:
    """In a process where importing them fails, all of floors 0 to 4 and the command line can be imported."""
    needed = [module for module in MODULES if room(module) not in ("ros", "__main__")]
    script = f"""
        import importlib, sys

        class Refusal:
            def find_spec(self, name, path=None, target=None):
                top = name.split(".")[0]
                if top in ("rclpy", "mujoco", "launch", "ament_index_python") or top.endswith({ROS_SUFFIXES!r}):
                    raise ModuleNotFoundError(f"{{name}} is refused", name=name)

        sys.meta_path.insert(0, Refusal())
        for module in {needed!r}:
            importlib.import_module(module)
        print("all imported")
        """
    command = [sys.executable, "-c", textwrap.dedent(script)]
    result = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT, timeout=120)
    assert result.stdout == "all imported\n", result.stderr
