"""``geomid fleet`` on two workers in this process; robots are short pieces of a shipped recording."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeAlias

import pytest
from fleet.bags import URDF, piece, torn, without_efforts

from geomid_ros.errors import InputError
from geomid_ros.files.models.posterior import read_population
from geomid_ros.fleet import fleet as clusters
from geomid_ros.fleet.fleet import Cluster

from .running import done, geomid, read, refused

distributed = pytest.importorskip("distributed")
fsspec = pytest.importorskip("fsspec")
Options: TypeAlias = tuple[str | Path, ...]
NOBODY = "tcp://127.0.0.1:9"


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """The address of a cluster of two workers."""
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=False,
        protocol="tcp",
        dashboard_address="127.0.0.1:0",
        silence_logs=50,
    ) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three robots with good bags, one of them also with bad ones, and one with none that is good."""
    folder = tmp_path_factory.mktemp("bags")
    for index, robot in enumerate(("ada", "bob", "cyd")):
        piece(folder / robot / "good", 0.5 * index)
    piece(folder / "ada" / "later", 3.0)
    torn(folder / "ada" / "torn")
    piece(folder / "ada" / "other_robot", 0.0, "arm7")
    without_efforts(folder / "dan" / "bare")
    return folder


@pytest.fixture(scope="module")
def options(tmp_path_factory: pytest.TempPathFactory) -> Options:
    """The options of all runs; to choose among effects takes most of an identification's time."""
    config = tmp_path_factory.mktemp("config") / "robot.yaml"
    config.write_text("/**: {ros__parameters: {candidates: []}}")
    return "--urdf", URDF, "--config", config


@pytest.fixture(scope="module")
def first(bags: Path, scheduler: str, options: Options, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder of a run, and what it printed."""
    out = tmp_path_factory.mktemp("out")
    return out, done("fleet", bags, *options, "--scheduler", scheduler, "--out", out)


def without_time(document: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in document.items() if key != "seconds"}


def test_every_robot_has_its_estimate_and_bad_bags_are_told(first: tuple[Path, str], bags: Path) -> None:
    out, printed = first
    for robot in ("ada", "bob", "cyd"):
        assert read(out / robot)["converged"]
        assert (out / robot / "identified.urdf").is_file()
        assert (out / robot / "posterior.npz").is_file()
    assert not (out / "dan").exists()
    told = " ".join(printed.split())
    assert f"{bags}/ada/torn/torn.mcap: truncated" in told
    assert f"Doubtful bag: {bags}/ada/other_robot: " in told
    assert f"{bags}/dan/bare: no effort is measured" in told
    assert "dan: none of its bags can be used" in told
    page = (out / "fleet.html").read_text()
    for name in ("ada", "bob", "cyd", "dan", "torn.mcap", "no effort is measured", "other_robot"):
        assert name in page
    assert read_population(out / "population.json").robots == 3


@pytest.mark.usefixtures("without_pictures")
def test_a_robot_of_one_bag_is_as_identify_finds_it(
    first: tuple[Path, str], bags: Path, options: Options, tmp_path: Path
) -> None:
    geomid("identify", bags / "bob" / "good", *options, "--out", tmp_path)
    expected, found = read(tmp_path), read(first[0] / "bob")
    for kind in ("nominal", "train", "held_out"):
        assert found["rms"].pop(kind) == pytest.approx(expected["rms"].pop(kind), rel=1e-9)
    for of_its_page in ("channels", "telling", "urdf_masses", "origin"):
        del expected[of_its_page]
    expected["notes"] = [note for note in expected["notes"] if not note.startswith("identified.urdf: ")]
    del expected["handover"]["urdf"]  # in which the file is judged, too, and the notes
    del found["handover"]["urdf"]
    assert without_time(found) == without_time(expected)


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Who does not answer on this machine will not."""
    monkeypatch.setattr(clusters, "_CONNECT", 1.0)


@pytest.mark.usefixtures("impatient")
def test_what_is_done_is_not_done_again_and_what_is_new_needs_workers(
    first: tuple[Path, str], bags: Path, options: Options
) -> None:
    """Nobody listens at the scheduler's address: all that there is to do must have been done. Another configuration is
    new, as another bag is."""
    out, _ = first
    before = read(out / "bob")
    arguments = ("fleet", bags, *options, "--scheduler", NOBODY, "--out", out)
    assert "no Dask scheduler answers" in refused(*arguments, "--cutoff", "4")
    new = piece(bags / "bob" / "new", 2.0)
    try:
        assert refused(*arguments).startswith(f"no Dask scheduler answers at {NOBODY}")
    finally:
        shutil.rmtree(new)
    done(*arguments)
    assert read(out / "bob") == before


def test_what_has_changed_is_told(first: tuple[Path, str], bags: Path, options: Options, tmp_path: Path) -> None:
    out, _ = first
    for robot in ("ada", "bob"):
        shutil.copytree(out / robot, tmp_path / robot)
    document = read(tmp_path / "ada")
    document["links"][2]["mass"] *= 2.0
    (tmp_path / "ada" / "estimate.json").write_text(json.dumps(document))
    printed = done("fleet", bags, *options, "--scheduler", NOBODY, "--out", out, "--since", tmp_path)
    (line,) = [line for line in printed.splitlines() if line.strip().startswith("ada ")]
    name, mass = document["links"][2]["name"], read(out / "ada")["links"][2]["mass"]
    assert f"mass of {name} changed by" in line
    assert f"{-mass:+.3g} ±" in printed
    assert f"{name}: mass {2 * mass:.3g} → {mass:.3g} kg" in printed
    (line,) = [line for line in printed.splitlines() if line.strip().startswith("bob ")]
    assert "→" not in line
    assert "changed" not in line


def test_bags_and_what_is_kept_in_object_stores(
    first: tuple[Path, str], bags: Path, scheduler: str, options: Options, tmp_path: Path
) -> None:
    memory = fsspec.filesystem("memory")
    for robot in ("ada", "bob"):
        memory.put(str(bags / robot / "good"), f"/store/{robot}/good", recursive=True)
    arguments = (*options, "--scheduler", scheduler, "--keep", "memory://kept", "--out", tmp_path)
    done("fleet", "memory://store", *arguments)
    assert without_time(read(tmp_path / "bob")) == without_time(read(first[0] / "bob"))
    assert len(memory.ls("/kept", detail=False)) == 7  # the plan, two files for each bag, one for each robot


@pytest.mark.usefixtures("without_pictures")
def test_bags_of_the_fleet_serve_as_a_prior(
    first: tuple[Path, str], bags: Path, options: Options, tmp_path: Path
) -> None:
    prior = ("--prior", first[0] / "population.json")
    result = geomid("identify", bags / "cyd" / "good", *options, *prior, "--out", tmp_path)
    assert result.exit_code in (0, 4), result.output
    assert read(tmp_path)["converged"]
    message = refused(
        "identify", bags / "cyd" / "good", "--urdf", URDF, *prior, "--model", first[0] / "bob/estimate.json"
    )
    assert "prior and model are both given; choose one" in message
    message = refused("identify", bags / "cyd" / "good", "--urdf", URDF, "--prior", first[0] / "bob" / "estimate.json")
    assert "not a population as geomid writes it" in message


def test_a_fleet_of_which_nothing_can_be_used_is_doubtful(bags: Path, scheduler: str, tmp_path: Path) -> None:
    result = geomid("fleet", bags / "dan", "--urdf", URDF, "--scheduler", scheduler, "--out", tmp_path)
    assert result.exit_code == 4
    assert "no effort is measured" in " ".join(result.stdout.split())


def test_what_is_kept_and_damaged_is_told_or_made_anew(
    bags: Path, scheduler: str, options: Options, tmp_path: Path
) -> None:
    arguments = ("fleet", bags / "bob", *options, "--scheduler", scheduler, "--out", tmp_path)
    done(*arguments)
    before = read(tmp_path / "bob")
    (outcome,) = (tmp_path / "kept").glob("bag-*.json")
    outcome.write_text("{")
    done(*arguments)
    assert read(tmp_path / "bob") == before
    (results,) = (tmp_path / "kept").glob("robot-*.safetensors")
    results.write_bytes(results.read_bytes()[:100])
    assert "delete it, and run the same again" in refused(*arguments)
    results.unlink()
    done(*arguments)
    assert without_time(read(tmp_path / "bob")) == without_time(before)


def test_options_that_cannot_be_are_refused(bags: Path, tmp_path: Path) -> None:
    arguments = ("fleet", bags, "--urdf", URDF, "--out", tmp_path)
    message = refused(*arguments, "--since", tmp_path / "nowhere")
    assert "nowhere is not a folder; give the folder of an earlier run" in message
    config = tmp_path / "config.yaml"
    config.write_text("/**:\n  ros__parameters:\n    forgetting_time: 10.0\n")
    assert refused(*arguments, "--config", config).startswith("forgetting_time is given")


def test_workers_of_another_version_are_refused(scheduler: str, monkeypatch: pytest.MonkeyPatch) -> None:
    versions = iter(["0.0.2", "0.0.1", "0.0.1"])
    monkeypatch.setattr(clusters, "installed_version", lambda: next(versions))
    with pytest.raises(InputError, match=r"its workers lack geomid_ros 0\.0\.2 .*\(they have 0\.0\.1\)"):
        Cluster(scheduler)


@pytest.mark.usefixtures("impatient")
def test_a_scheduler_without_workers_is_told() -> None:
    with (
        distributed.LocalCluster(
            n_workers=0, processes=False, protocol="tcp", dashboard_address="127.0.0.1:0", silence_logs=50
        ) as empty,
        pytest.raises(InputError, match="has no workers; start some"),
    ):
        Cluster(empty.scheduler_address)
