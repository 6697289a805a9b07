"""``posterior.npz`` and ``population.json`` are read as they were written; what cannot have been is refused in one
sentence."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.estimation.estimate import EffectEstimate
from geomid_ros.estimation.population import Population
from geomid_ros.estimation.posterior import EffectCoordinate, Posterior
from geomid_ros.files.models.posterior import (
    POSTERIOR,
    read_population,
    read_posterior,
    read_remainder,
    write_population,
    write_posterior,
)
from geomid_ros.gap.features import Basis, KnownRemainder
from geomid_ros.model.effects import Quantity

from .estimates import estimate_of, link_estimate

EFFECTS = tuple(
    EffectEstimate(name=name, joint="elbow", parameters={parameter: Quantity(value, 0.1, unit)}, from_data=0.5)
    for name, parameter, value, unit in (
        ("viscous_friction", "coefficient", 0.4, "N m s/rad"),
        ("effort_offset", "offset", -0.2, "N m"),
    )
)


def posterior() -> Posterior:
    links = link_estimate("upper", ("bracket", "ä"), seed=1), link_estimate("lower", seed=2)
    return estimate_of(*links, effects=EFFECTS).posterior


@pytest.fixture
def written(tmp_path: Path) -> Path:
    path = tmp_path / POSTERIOR
    assert write_posterior(path, posterior()) == [path]
    return path


def test_what_is_written_is_read(written: Path, tmp_path: Path) -> None:
    found, expected = read_posterior(written), posterior()
    for field in fields(Posterior):
        read, made = (getattr(each, field.name) for each in (found, expected))
        assert np.array_equal(read, made) if isinstance(made, np.ndarray) else read == made
    assert not found.covariance.flags.writeable
    write_posterior(tmp_path / "again.npz", expected)
    assert (tmp_path / "again.npz").read_bytes() == written.read_bytes()


def arrays(change: Callable[[dict], dict]) -> Callable[[Path], object]:
    """A file with other arrays."""

    def changed(path: Path) -> None:
        with np.load(path) as archive:
            given = dict(archive)
        np.savez(path, **change(given))

    return changed


def headed(change: Callable[[dict], object]) -> Callable[[Path], object]:
    """A file with another header."""

    def changed(arrays: dict) -> dict:
        header = json.loads(str(arrays["posterior"]))
        change(header)
        return arrays | {"posterior": np.array(json.dumps(header))}

    return arrays(changed)


def flipped(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def claims_more_than_memory(path: Path) -> None:
    content = io.BytesIO()
    np.lib.format.write_array_header_1_0(content, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)})
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("posterior.npy", content.getvalue())


def with_a_member_that_is_no_array(path: Path) -> None:
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("scales", b"xxx")


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (headed(lambda header: header.update(format=3)), "has format 3, this version reads formats 1 and 2"),
        (headed(lambda header: header["links"].pop()), "of shape"),
        (headed(lambda header: header["effects"].reverse()), "its text: effects are not in order"),
        (arrays(lambda own: own | {"covariance": own["covariance"].astype("f4")}), "'covariance' is float32"),
        (arrays(lambda own: own | {"covariance": own["covariance"] * np.nan}), "finite"),
        (arrays(lambda own: own | {"covariance": -own["covariance"]}), "not positive semidefinite"),
        (arrays(lambda own: own | {"covariance": np.triu(own["covariance"])}), "not positive semidefinite"),
        (arrays(lambda own: own | {"parameters": -own["parameters"]}), "not physically consistent"),
        (arrays(lambda own: own | {"scales": 0.0 * own["scales"]}), "not positive"),
        (arrays(lambda own: own | {"prior": np.array([{}], dtype=object)}), "Object arrays"),
        (lambda path: path.write_bytes(path.read_bytes()[:-1]), "cannot be read"),
        (flipped, "cannot be read"),
        (lambda path: np.savez_compressed(path, posterior=np.zeros(10**6)), "compressed"),
        (claims_more_than_memory, "cannot be read"),
        (with_a_member_that_is_no_array, "not an array"),
        (Path.unlink, "cannot be read"),
    ],
)
def test_what_is_damaged_or_no_estimate_can_be_is_refused(
    written: Path, damage: Callable[[Path], object], reason: str
) -> None:
    damage(written)
    refused(written, reason)


SIZES = 5, 3


def remainder() -> KnownRemainder:
    rng = np.random.default_rng(4)
    return KnownRemainder(
        joints=("shoulder", "elbow"),
        channels=("effort shoulder", "effort elbow"),
        basis=Basis(np.sort(rng.standard_normal((2, 3, 2))), tuple(rng.uniform(0.5, 2.0, size) for size in SIZES)),
        means=tuple(rng.standard_normal(size) for size in SIZES),
        triangles=tuple(np.triu(rng.standard_normal((size, size))) for size in SIZES),
    )


@pytest.fixture
def with_remainder(tmp_path: Path) -> Path:
    path = tmp_path / POSTERIOR
    write_posterior(path, posterior(), remainder())
    return path


@pytest.mark.parametrize("known", [SIZES[0], 0])
def test_what_the_model_lacks_is_read_as_it_was_written(known: int, tmp_path: Path) -> None:
    """Nothing may be known of a channel."""
    own, path = remainder(), tmp_path / POSTERIOR
    means, triangles = (own.means[0][:known], own.means[1]), (own.triangles[0][:known, :known], own.triangles[1])
    expected = replace(own, means=means, triangles=triangles)
    write_posterior(path, posterior(), expected)
    found = read_remainder(path)
    assert found is not None
    assert (found.joints, found.channels) == (expected.joints, expected.channels)
    assert np.array_equal(found.basis.knots, expected.basis.knots)
    for each, own in ((found.means, expected.means), (found.basis.scales, expected.basis.scales)):
        assert all(map(np.array_equal, each, own))
    for read, made in zip(found.triangles, expected.triangles, strict=True):
        np.testing.assert_allclose(read, made, rtol=1e-6)
    assert np.array_equal(read_posterior(path).covariance, posterior().covariance)


def test_what_would_be_refused_is_not_written(tmp_path: Path) -> None:
    own, path = remainder(), tmp_path / POSTERIOR
    for wrong in (
        replace(own, means=(np.inf * own.means[0], own.means[1])),
        replace(own, basis=replace(own.basis, scales=(1e4 * own.basis.scales[0], own.basis.scales[1]))),
        replace(own, triangles=(np.nan * own.triangles[0], own.triangles[1])),
    ):
        write_posterior(path, posterior(), wrong)
        assert read_remainder(path) is None
        assert np.array_equal(read_posterior(path).covariance, posterior().covariance)


def test_files_without_it_are_read(written: Path) -> None:
    assert read_remainder(written) is None
    headed(lambda header: header.update(format=1))(written)
    assert read_remainder(written) is None
    assert np.array_equal(read_posterior(written).covariance, posterior().covariance)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (headed(lambda header: header["remainder"].update(joints=["one"])), "'knots' is float64 of shape"),
        (headed(lambda header: header["remainder"].update(channels=["a", "b", "c"])), "cannot be read"),
        (arrays(lambda own: own | {"knots": -own["knots"]}), "invalid ranges"),
        (arrays(lambda own: own | {"scales_0": 0.0 * own["scales_0"]}), "invalid scales"),
        (arrays(lambda own: own | {"mean_1": own["mean_1"][:2]}), "'triangle_1' is float32 of shape"),
        (arrays(lambda own: own | {"triangle_0": own["triangle_0"].astype("f8")}), "'triangle_0' is float64"),
    ],
)
def test_a_remainder_that_cannot_be_is_refused(
    with_remainder: Path, change: Callable[[Path], object], reason: str
) -> None:
    change(with_remainder)
    refused(with_remainder, reason, read_remainder)


def refused(path: Path, reason: str, read: Callable[[Path], object] = read_posterior) -> None:
    with pytest.raises(InputError, match=reason) as raised:
        read(path)
    assert str(raised.value).startswith(f"{path}: ")
    assert "\n" not in str(raised.value)


def population() -> Population:
    rng = np.random.default_rng(4)
    bodies = [link_estimate(name, seed=seed).parameters for seed, name in enumerate(("upper", "lower"))]
    effects = (
        EffectCoordinate(name="viscous_friction", place="a", parameter="coefficient", unit="N m s/rad", positive=True),
        EffectCoordinate(name="effort_offset", place="a", parameter="offset", unit="N m", positive=False),
        EffectCoordinate(name="effort_offset", place="b", parameter="offset", unit="N m", positive=False),
    )
    root = 0.1 * rng.normal(size=(23, 30))
    return Population(
        links=("upper", "lower"),
        effects=effects,
        parameters=np.concatenate([*bodies, [0.4, -0.2, 0.0]]),
        covariance=root @ root.T,
        scales=np.array([2.0, 0.5]),
        robots=20,
    )


@pytest.fixture
def of_fleet(tmp_path: Path) -> Path:
    path = tmp_path / "population.json"
    write_population(path, population())
    return path


def test_a_population_is_read_as_it_was_written(of_fleet: Path) -> None:
    found, expected = read_population(of_fleet), population()
    for field in fields(Population):
        read, made = (getattr(each, field.name) for each in (found, expected))
        if isinstance(made, np.ndarray):
            np.testing.assert_allclose(read, made, rtol=1e-12, atol=1e-15)
            assert not read.flags.writeable
        else:
            assert read == made


def _effect(**changes: Any) -> Callable[[dict[str, Any]], None]:
    return lambda document: document["effects"][0].update(changes)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda document: document.pop("covariance"), "it has no 'covariance'"),
        (lambda document: document.update(format=9), "has format 9, this version reads format 1"),
        (lambda document: document.update(covariance="AAAA"), "covariance is not of its links and effects"),
        (lambda document: document["links"].pop(), "covariance is not of its links and effects"),
        (lambda document: document["links"][0].update(mass=-1.0), "is not physically consistent"),
        (_effect(value=-1.0), "none that robots can have"),
        (lambda document: document["effects"][1].update(scale=0.0), "none that robots can have"),
        (lambda document: document["effects"].reverse(), "none that robots can have"),
        (lambda document: document["effects"][2].update(document["effects"][1]), "none that robots can have"),
    ],
)
def test_what_no_fleet_writes_is_refused(of_fleet: Path, change: Callable[[dict[str, Any]], Any], why: str) -> None:
    document = json.loads(of_fleet.read_text())
    change(document)
    of_fleet.write_text(json.dumps(document))
    with pytest.raises(InputError, match=why) as caught:
        read_population(of_fleet)
    assert str(caught.value).startswith(str(of_fleet))


def test_a_covariance_that_is_none_is_refused(tmp_path: Path) -> None:
    wrong = population().covariance.copy()
    wrong[0, 1] = wrong[1, 0] = 10.0
    write_population(tmp_path / "population.json", replace(population(), covariance=wrong))
    with pytest.raises(InputError, match="none that robots can have"):
        read_population(tmp_path / "population.json")
