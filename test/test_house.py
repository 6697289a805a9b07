"""The house: which floor may import which, who may import what from outside, and what must not be needed."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from geomid_ros.model.effects import EFFECTS

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "geomid_ros"
# A room is a folder or a module right under the package. What is not named here fails the first test.
FLOORS = {
    "errors": -1,
    "types": -1,
    "geometry": 0,
    "options": 0,
    "model": 1,
    "signals": 2,
    "estimation": 2,
    "inference": 3,
    "monitoring": 3,
    "checks": 4,
    "gap": 4,
    "excitation": 3,
    "control": 4,
    "files": 5,
    "simulation": 5,
    "resimulation": 6,
    "session": 7,
    "report": 8,
    "exports": 8,
    "fleet": 8,
    "api": 9,
    "live": 9,
    "__init__": 10,
    "ros": 10,
    "commands": 11,
    "__main__": 12,
}
SHARED = ("errors", "types", "options")  # with the simulator
# Names from outside, and the rooms in which alone they may be imported.
KEPT_IN = {"coal": ("model",), "pinocchio": ("model",), "mujoco": ("simulation", "resimulation"), "rclpy": ("ros",)}
COMPUTED = "(computed)"  # a name that is known only when the program runs: the player's message types
MOST_POSITIONAL = 6
FRAGMENTS = ("What", "Whether", "Of", "Those", "How", "Which", "That")
ROS_SUFFIXES = ("_msgs", "_srvs", "_interfaces")


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}


@cache
def tree_of(path: Path) -> ast.Module:
    """What a file says."""
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


@cache
def imports(module: str) -> tuple[tuple[str, bool], ...]:
    """Every name that a module imports, wherever it does so, and whether that is at once when it is loaded."""
    return tuple(imported(MODULES[module]))


def nodes(node: ast.AST, at_once: bool = True) -> Iterator[tuple[ast.AST, bool]]:
    """All that is in a node, and whether it is run at once: what is in a function is not."""
    yield node, at_once
    at_once &= not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    for child in ast.iter_child_nodes(node):
        yield from nodes(child, at_once)


def imported(path: Path) -> Iterator[tuple[str, bool]]:
    """The same of a file."""
    for node, at_once in nodes(tree_of(path)):
        if isinstance(node, ast.Import):
            yield from ((alias.name, at_once) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                yield whole if whole in MODULES else str(node.module), at_once
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("import_module", "__import__")):
            yield from ((name, at_once) for name in computed(node.args[0]))


def computed(name: ast.expr) -> list[str]:
    """The modules that an expression may name."""
    match name:
        case ast.Constant(value=str(module)):
            return [module]
        case ast.Subscript(value=ast.Name(id="_HOMES")):
            return []  # those that the file imports for type checkers: test/api holds that
        case ast.JoinedStr(values=[ast.Constant(value=str(folder)), _]) if folder.endswith("."):
            return [module for module in MODULES if module.rpartition(".")[0] == folder[:-1]]
    return [COMPUTED]


def room(module: str) -> str:
    """The room of a module of the package."""
    return f"{module}.__init__".split(".")[1]


def allowed(module: str, name: str, at_once: bool) -> bool:
    """Whether a module may import a name: of its own room, of a lower floor, or from outside what its room keeps.

    The simulator shares no physics with the estimator: else a mistake on both sides of the comparison would go unseen.
    """
    own, top = room(module), name.split(".", maxsplit=1)[0]
    if top == PACKAGE.name:
        if name not in MODULES or own not in FLOORS:
            return False
        lower = room(name) in SHARED if own == "simulation" else FLOORS[room(name)] < FLOORS[own]
        return lower or room(name) == own
    keepers = ("ros",) if top.endswith(ROS_SUFFIXES) or top == COMPUTED else KEPT_IN.get(top, (own,))
    return own in keepers and not (top == "mujoco" and at_once)


def test_every_room_is_on_its_floor_and_imports_what_it_may() -> None:
    assert {room(module) for module in MODULES} == set(FLOORS)
    assert not [
        f"{module} imports {name}"
        for module in MODULES
        for name, at_once in imports(module)
        if not allowed(module, name, at_once)
    ]


@pytest.mark.parametrize(
    ("module", "name", "at_once", "may"),
    [
        ("geomid_ros.model.robot", "geomid_ros.gap", True, False),  # higher
        ("geomid_ros.model.robot", "geomid_ros.nowhere", True, False),
        ("geomid_ros.model.robot", "mujoco", False, False),
        ("geomid_ros.model.robot", "pinocchio", True, True),
        ("geomid_ros.gap", "pinocchio", True, False),
        ("geomid_ros.simulation", "mujoco", True, False),
        ("geomid_ros.simulation", "mujoco", False, True),
        ("geomid_ros.simulation", "geomid_ros.errors", True, True),
        ("geomid_ros.simulation", "geomid_ros.geometry", True, False),
        ("geomid_ros.files", "sensor_msgs.msg", False, False),
        ("geomid_ros.files", COMPUTED, False, False),
        ("geomid_ros.ros", "rclpy.node", True, True),
    ],
)
def test_what_is_not_allowed_is_noticed(module: str, name: str, at_once: bool, may: bool) -> None:
    """Else the theorem above would hold of anything."""
    assert allowed(module, name, at_once) is may


def small_room(module: str) -> str:
    """The folder of a module, as long as it has no folders in it; else the module itself."""
    folder = module.rpartition(".")[0]
    divided = any(other.startswith(f"{folder}.") and other.count(".") > module.count(".") for other in MODULES)
    return module if divided else folder


def test_there_are_no_circles() -> None:
    """Neither of files nor of rooms."""
    for of in (str, small_room):
        graph: dict[str, set[str]] = {}
        for module in MODULES:
            used = {of(name) for name, _ in imports(module) if name in MODULES}
            graph.setdefault(of(module), set()).update(used - {of(module)})
        try:
            list(TopologicalSorter(graph).static_order())
        except CycleError as error:
            pytest.fail(f"a circle of imports: {' <- '.join(error.args[1])}")


# What has an effect's name but is none: a command, and parameters of the node and of the signals.
NAMESAKES = {
    ("geomid_ros.api.robot", "effort_gain"),
    ("geomid_ros.commands", "payload"),
    ("geomid_ros.excitation.belief", "payload"),
    ("geomid_ros.exports.descriptions", "viscous_friction"),
    ("geomid_ros.checks.causes", "effort_gain"),
    ("geomid_ros.session.configuration", "effort_gain"),
    ("geomid_ros.session.session", "effort_gain"),
    ("geomid_ros.session.session", "effort_delay"),
}
OF_EFFECTS = "geomid_ros.model.effects"


def test_only_an_effect_knows_itself() -> None:
    """Nobody asks for it by its name or by its class, but effects that have to do with it, and the list of all."""
    known = {(name, node.value) for name, path in OUTSIDERS.items() for node in texts(path) if node.value in EFFECTS}
    assert known == NAMESAKES
    homes = {effect.__module__ for effect in EFFECTS.values()}
    for name in OUTSIDERS:
        files = {other for other, _ in imports(name)} & homes
        assert not files, f"{name} imports {files}"
    for template in PACKAGE.rglob("*.j2"):
        words = set(re.findall(r"\w+", template.read_text(encoding="utf-8")))
        assert not {name for name in words & EFFECTS.keys() if "_" in name}, template


OUTSIDERS = {
    name: path for name, path in MODULES.items() if not name.startswith(OF_EFFECTS) and room(name) != "simulation"
}


def texts(path: Path) -> Iterator[ast.Constant]:
    """The literal texts in a file."""
    return (node for node in ast.walk(tree_of(path)) if isinstance(node, ast.Constant) and isinstance(node.value, str))


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
    result = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT, timeout=600)
    assert result.stdout == "all imported\n", result.stderr


def test_no_call_leaves_the_meaning_of_many_arguments_to_their_order() -> None:
    for module, path in MODULES.items():
        for call in ast.walk(tree_of(path)):
            if isinstance(call, ast.Call):
                in_order = sum(not isinstance(argument, ast.Starred) for argument in call.args)
                assert in_order <= MOST_POSITIONAL, f"{module}, line {call.lineno}: {ast.unparse(call.func)}"


def definitions(module: Path) -> Iterator[ast.Module | ast.ClassDef | ast.FunctionDef]:
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef)
    return (node for node in ast.walk(tree_of(module)) if isinstance(node, kinds))


def test_no_two_public_classes_share_a_name() -> None:
    names = [node.name for path in MODULES.values() for node in definitions(path) if isinstance(node, ast.ClassDef)]
    twice = {name for name in names if names.count(name) > 1 and not name.startswith("_")}
    assert not twice


def test_every_bench_runs() -> None:
    """`python -m benchmarks.NAME` of a module with an experiment does something."""
    for path in (ROOT / "benchmarks").glob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert "__main__" in text or not re.search(r"^def (run\(report|main\()", text, re.MULTILINE), path


def test_a_docstring_begins_with_the_thing_or_with_what_is_done() -> None:
    """Not with a genitive or an indirect question, which nobody finds by searching."""
    for module, path in MODULES.items():
        for node in definitions(path):
            words = (ast.get_docstring(node) or "").split()
            assert words[:1] not in ([word] for word in FRAGMENTS), f"{module}: {' '.join(words[:8])}"
