"""What is released: wheel and sdist are whole, the same bytes whenever they are built, and work alone."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from importlib.metadata import PathDistribution
from pathlib import Path

import pytest
import tree
from packaging.requirements import Requirement

import geomid_ros

ROOT = tree.ROOT
DATE = "1700000000"
# Of the repository, not of a release.
_LEFT_OUT = {Path(".gitignore")}
# Of the tests that come with the sdist some that need its other files; bags, pages and pictures are looked at here.
_QUICK = ("test/files/test_urdf.py", "test/model/test_names.py")


def run(*command: str | Path, cwd: Path, **variables: str) -> str:
    """What a command printed; fails with its whole output. It is not told where this package is."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | variables
    output = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    result = subprocess.run([str(part) for part in command], cwd=cwd, env=environment, check=False, **output)
    assert result.returncode == 0, result.stdout
    return str(result.stdout)


def build(source: Path, to: Path) -> None:
    """Sdist and, from it, the wheel."""
    pytest.importorskip("build", reason="what builds packages is not installed: pip install build")
    options = ("--no-isolation", "--outdir", to)
    compiler = tree.quick_compiler(source.parent)
    run(sys.executable, "-m", "build", *options, source, cwd=source, SOURCE_DATE_EPOCH=DATE, CC=compiler)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with sdist and wheel in ``built``, and in ``again`` those of another copy with other dates."""
    folder = tmp_path_factory.mktemp("distribution")
    build(tree.copy(folder / "tree"), folder / "built")
    other = tree.copy(folder / "elsewhere/another name")
    for number, path in enumerate(sorted(other.rglob("*"))):
        os.utime(path, (number, number))
    build(other, folder / "again")
    return folder


@pytest.fixture(scope="module")
def unpacked(built: Path) -> Path:
    """What the sdist holds."""
    (archive,) = (built / "built").glob("*.tar.gz")
    with tarfile.open(archive) as file:
        file.extractall(built / "unpacked", filter="data")
    (folder,) = (built / "unpacked").iterdir()
    return folder


@pytest.fixture(scope="module")
def alone(built: Path) -> Path:
    """An environment with the wheel, and with what it requires, which is that of these tests."""
    folder = built / "alone"
    venv.create(folder, symlinks=True)
    python = folder / "bin/python"
    site = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder).strip())
    required = sysconfig.get_path("purelib")
    (site / "required.pth").write_text(f"import site; site.addsitedir({required!r})\n", encoding="utf-8")
    (wheel,) = (built / "built").glob("*.whl")
    options = ("--no-deps", "--no-index", "--force-reinstall")
    run(sys.executable, "-m", "pip", "--python", python, "install", *options, wheel, cwd=folder)
    where = run(python, "-c", "import geomid_ros; print(geomid_ros.__file__)", cwd=folder).strip()
    assert Path(where).is_relative_to(folder), where
    return folder


def test_two_builds_give_the_same_bytes(built: Path) -> None:
    first, second = (sorted((built / name).iterdir()) for name in ("built", "again"))
    assert [path.name for path in first] == [path.name for path in second]
    for one, other in zip(first, second, strict=True):
        assert one.read_bytes() == other.read_bytes(), one.name


def test_sdist_and_wheel_are_whole(built: Path, unpacked: Path) -> None:
    """All of the repository, and all of the package with what is compiled."""
    held = {path.relative_to(unpacked) for path in unpacked.rglob("*") if path.is_file()}
    made = {path for path in held if path.parts[0] in ("PKG-INFO", "geomid_ros.egg-info")}
    assert held - made == tree.files() - _LEFT_OUT
    for file in held - made - {Path("setup.cfg")}:  # to which setuptools adds a section
        assert (unpacked / file).read_bytes() == (ROOT / file).read_bytes(), file
    (wheel,) = (built / "built").glob("*.whl")
    with zipfile.ZipFile(wheel) as file:
        held = {Path(name) for name in file.namelist()}
    compiled = {path for path in held if path.suffix == ".so"}
    assert compiled == {Path("geomid_ros/geometry/_native.abi3.so")}, "needs a C compiler"
    assert {path for path in held - compiled if path.parts[0] == "geomid_ros"} == {
        path for path in tree.files() if path.parts[0] == "geomid_ros"
    }


def test_installed_alone_it_identifies_and_passes_tests_of_the_sdist(
    alone: Path, unpacked: Path, tmp_path: Path
) -> None:
    bags = alone / "share/geomid_ros/bags"
    geomid = alone / "bin/geomid"
    assert geomid_ros.__version__ in run(geomid, "--version", cwd=tmp_path)
    run(geomid, "identify", bags / "arm3", "--urdf", bags / "arm3.urdf", "--candidates", "none", cwd=tmp_path)
    assert {path.name for path in (tmp_path / "geomid_out").iterdir()} == {
        *("estimate.json", "identified.urdf", "effects.yaml", "posterior.npz", "identification.png", "report.html"),
        *("links.csv", "effects.csv", "channels.csv"),
    }
    assert (alone / "bin/geomid_node").exists()
    quick = [unpacked / test for test in _QUICK]
    printed = run(alone / "bin/python", "-P", "-m", "pytest", "-q", "-p", "no:cacheprovider", *quick, cwd=unpacked)
    assert re.search(r"^[1-9]\d* passed", printed, re.MULTILINE), printed


def names(file: str) -> set[str]:
    """What a file of requirements names."""
    lines = (ROOT / file).read_text(encoding="utf-8").splitlines()
    return {_key(line) for line in lines if line and line[0] not in "#-"}


def _key(requirement: str) -> str:
    return re.sub(r"[-_.]+", "-", Requirement(requirement).name).lower()


def test_the_environment_of_make_has_what_the_package_requires(built: Path) -> None:
    (wheel,) = (built / "built").glob("*.whl")
    (information,) = (path for path in zipfile.Path(wheel).iterdir() if path.name.endswith(".dist-info"))
    declared = [Requirement(line) for line in PathDistribution(information).requires or ()]
    wanted = {
        _key(str(one))
        for one in declared
        if one.marker is None or any(one.marker.evaluate({"extra": extra}) for extra in ("", "ros", "dashboard"))
    }
    assert wanted == names("requirements.txt") - {"setuptools"}
    tests = {_key(str(one)) for one in declared if one.marker and one.marker.evaluate({"extra": "test"})} - wanted
    assert tests <= names("requirements-test.txt")
    assert wanted | tests <= names("constraints.txt")


def test_no_key_of_a_release_means_pypi() -> None:
    """A farm that builds packages for ROS takes none: bloom sets the distribution's variables alone."""
    package = pytest.importorskip("catkin_pkg.package").parse_package(ROOT / "package.xml")

    def keys(**variables: str) -> set[str]:
        package.evaluate_conditions({"ROS_DISTRO": "jazzy", "ROS_VERSION": "2", "ROS_PYTHON_VERSION": "3", **variables})
        depends = [*package.exec_depends, *package.test_depends, *package.build_depends, *package.buildtool_depends]
        return {one.name for one in depends if one.evaluated_condition}

    assert not {key for key in keys() if key.endswith("-pip")}
    assert keys(GEOMID_PYPI="1") - keys() == {"python3-rosbags-pip", "python3-trimesh-pip", "python3-mujoco-pip"}
