"""What a model lacked where it was identified, as a session finds it beside the model's file."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from geomid_ros.estimation.estimate import LinksInformation
from geomid_ros.files.models import posterior as files
from geomid_ros.gap.features import Basis, KnownRemainder
from geomid_ros.session.gap import known_remainder_of, prior_information

NOTHING = np.zeros((0, 0))
KEPT = KnownRemainder(
    joints=("shoulder",), channels=("effort",), basis=Basis(NOTHING, (NOTHING,)), means=(NOTHING,), triangles=(NOTHING,)
)


def session(folder: Path, known: object = True, channel: str = "effort") -> Any:
    return SimpleNamespace(
        loaded=SimpleNamespace(source=str(folder / "estimate.json"), links_information=known),
        robot=SimpleNamespace(joint_names=["shoulder"]),
        model=SimpleNamespace(channels=[SimpleNamespace(name=channel)]),
        review=SimpleNamespace(settled=[]),
    )


@pytest.mark.parametrize(
    ("stored", "change", "used", "told"),
    [
        (KEPT, {}, True, []),
        (KEPT, {"channel": "current"}, False, ["its remainder is of effort, here current are measured"]),
        (None, {}, False, ["has no remainder"]),
        ("no file", {}, False, ["no posterior.npz in the same folder"]),
        ("no file", {"known": None}, False, []),
    ],
    ids=["kept", "other channels", "none in the file", "no file", "a description alone"],
)
def test_the_remainder_beside_a_model_is_used_or_its_lack_told_once(
    stored: Any, change: dict[str, Any], used: bool, told: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if stored != "no file":
        (tmp_path / files.POSTERIOR).touch()
        monkeypatch.setattr("geomid_ros.session.gap.read_remainder", lambda _: stored)
    own = session(tmp_path, **change)
    assert known_remainder_of(own) is (KEPT if used else None)
    assert len(own.review.settled) == len(told)
    for note, part in zip(own.review.settled, told, strict=True):
        assert part in note
        assert "evaluated without the stored remainder" in note


def test_of_a_robot_with_an_imu_the_total_mass_is_known_no_better_than_gravity() -> None:
    """Two recordings whose accelerometers are off along gravity: by that share the masses may be, and no direction
    across is known any worse."""
    rng = np.random.default_rng(1)
    known = LinksInformation(np.triu(rng.normal(size=(20, 20))) + 100.0 * np.eye(20), rng.normal(size=20))
    inertias = rng.uniform(1.0, 2.0, size=20)
    own: Any = SimpleNamespace(
        loaded=SimpleNamespace(
            links_information=known,
            information=lambda _: known,
            coefficient_stds=lambda _: None,
            posterior=None,
            source="estimate.json",
        ),
        prior=np.append(inertias, 7.0),
        model=SimpleNamespace(body_names=[]),
        relative_mass_std=0.01,
    )
    found, _ = prior_information(own)
    assert found is not None
    before, after = (np.linalg.inv(each.rows.T @ each.rows) for each in (known, found))
    moved = np.where(np.arange(20) % 10 < 4, inertias, 0.0) * 0.01 * np.sqrt(2.0)  # either accelerometer is off
    np.testing.assert_allclose(after, before + np.outer(moved, moved), rtol=1e-9, atol=1e-12)
    best = [np.linalg.solve(each.rows, -each.residuals) for each in (known, found)]
    np.testing.assert_allclose(*best, rtol=1e-9)
    own.relative_mass_std = 0.0
    same, _ = prior_information(own)
    assert same is not None
    np.testing.assert_array_equal(same.rows, known.rows)
