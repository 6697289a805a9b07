"""The launch files name only what exists. They are read, not run: ``launch`` has no wheel."""

import ast
from collections.abc import Iterator
from importlib.metadata import distribution
from pathlib import Path

import pytest
import yaml

from geomid_ros.signals.messages import JOINT_STATES, ODOM

ROOT = Path(__file__).parents[1]
LAUNCH_FILES = sorted((ROOT / "launch").glob("*.launch.py"))


@pytest.fixture(params=LAUNCH_FILES, ids=lambda path: path.name)
def tree(request: pytest.FixtureRequest) -> ast.Module:
    source: Path = request.param
    return ast.parse(source.read_text(), filename=str(source))


def calls(tree: ast.Module, name: str) -> Iterator[ast.Call]:
    """Every call of the plain name, in no particular order."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == name:
            yield node


def first_arguments(tree: ast.Module, name: str) -> set[str]:
    return {ast.literal_eval(call.args[0]) for call in calls(tree, name)}


def test_there_is_a_launch_file() -> None:
    assert LAUNCH_FILES


def test_executables_exist(tree: ast.Module) -> None:
    scripts = distribution("geomid_ros").entry_points.select(group="console_scripts")
    nodes = [{keyword.arg: keyword.value for keyword in call.keywords} for call in calls(tree, "Node")]
    assert nodes
    for node in nodes:
        assert ast.literal_eval(node["package"]) == "geomid_ros"
        assert callable(scripts[ast.literal_eval(node["executable"])].load())


def defaults(tree: ast.Module) -> dict[str, ast.expr]:
    """The default value of every launch argument."""
    return {
        ast.literal_eval(call.args[0]): keyword.value
        for call in calls(tree, "DeclareLaunchArgument")
        for keyword in call.keywords
        if keyword.arg == "default_value"
    }


def text(part: ast.expr, tree: ast.Module) -> str:
    """What a text or a launch argument stands for, unless somebody gives the argument."""
    if isinstance(part, ast.Call):
        return text(defaults(tree)[ast.literal_eval(part.args[0])], tree)
    return str(ast.literal_eval(part))


def test_parameter_files_exist(tree: ast.Module) -> None:
    joined = [call.args[0] for call in calls(tree, "PathJoinSubstitution")]
    assert joined
    for parts in joined:
        assert isinstance(parts, ast.List)
        share, *below = parts.elts
        assert ast.unparse(share) == "FindPackageShare('geomid_ros')"
        parameters = yaml.safe_load(ROOT.joinpath(*(text(part, tree) for part in below)).read_text())
        assert all("ros__parameters" in node for node in parameters.values())


def test_the_topics_that_can_be_given_are_the_nodes(tree: ast.Module) -> None:
    """And are called by their own names unless somebody gives others."""
    (node,) = calls(tree, "Node")
    (pairs,) = [keyword.value for keyword in node.keywords if keyword.arg == "remappings"]
    assert isinstance(pairs, ast.List)
    topics = [tuple(text(part, tree) for part in pair.elts) for pair in pairs.elts if isinstance(pair, ast.Tuple)]
    assert topics == [(JOINT_STATES, JOINT_STATES), (ODOM, ODOM)]


def test_arguments_are_declared_and_used(tree: ast.Module) -> None:
    declared = first_arguments(tree, "DeclareLaunchArgument")
    assert declared == first_arguments(tree, "LaunchConfiguration")
    assert declared >= {"config", "params_file", "namespace", "use_sim_time"}
