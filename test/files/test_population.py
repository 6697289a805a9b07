"""``population.json`` is read as it was written, and what no fleet can have written is refused in one sentence."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from geomid_ros.errors import InputError
from geomid_ros.estimation.population import Population
from geomid_ros.estimation.posterior import EffectCoordinate
from geomid_ros.files.models.posterior import read_population, write_population

from .estimates import link_estimate


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
def written(tmp_path: Path) -> Path:
    path = tmp_path / "population.json"
    write_population(path, population())
    return path


def test_what_is_written_is_read(written: Path) -> None:
    found, expected = read_population(written), population()
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
def test_what_no_fleet_writes_is_refused(written: Path, change: Callable[[dict[str, Any]], Any], why: str) -> None:
    document = json.loads(written.read_text())
    change(document)
    written.write_text(json.dumps(document))
    with pytest.raises(InputError, match=why) as refused:
        read_population(written)
    assert str(refused.value).startswith(str(written))


def test_a_covariance_that_is_none_is_refused(tmp_path: Path) -> None:
    found = population()
    wrong = found.covariance.copy()
    wrong[0, 1] = wrong[1, 0] = 10.0
    broken = Population(**{f.name: getattr(found, f.name) for f in fields(Population)} | {"covariance": wrong})
    write_population(tmp_path / "population.json", broken)
    with pytest.raises(InputError, match="none that robots can have"):
        read_population(tmp_path / "population.json")
