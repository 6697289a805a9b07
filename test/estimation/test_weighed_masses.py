"""Weighed masses in the estimate: rows like any other, and never mistaken for what was measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.model.weighed_masses import WeighedMass
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.session import Session

from . import arms
from .arms import Case, Motion, arm, efforts, shipped

STD = 0.02  # of the scales [kg]


def standing(case: Case) -> float:
    """Mass of the links that do not move [kg]."""
    tree = case.model.robot.tree
    return sum(p[0] for p in tree.inertials.values()) - sum(b.parameters[0] for b in case.model.robot.bodies)


def true_total(case: Case) -> float:
    return standing(case) + float(np.sum(case.true.links[:, 0]))


def total(case: Case, found: Estimate) -> float:
    fixed = [b.parameters[0] for k, b in enumerate(case.model.robot.bodies) if k not in case.model.identified]
    return standing(case) + sum(fixed) + sum(link.mass for link in found.links)


def solved(case: Case, *known: WeighedMass, **settings: object) -> Estimate:
    return arms.solved(case, known=known, **settings)


def weighed(mass: float, std: float = STD, link: str = "total") -> WeighedMass:
    return WeighedMass((link,), mass, std)


def with_lump(case: Case, mass: float) -> Case:
    """The same robot with a point mass on the first joint's axis: no joint of an arm on a table feels it."""
    links = case.true.links.copy()
    links[0, 0] += mass
    changed = replace(case.true, links=links)
    moving = Motion(case.samples.position, case.samples.velocity, case.samples.acceleration)
    np.testing.assert_allclose(efforts(case.model.robot, changed, moving), case.noiseless, atol=1e-9)
    return replace(case, true=changed)


@pytest.mark.parametrize("objective", ["residual", "geodesic"])
def test_what_joints_do_not_feel_a_scale_does(objective: str) -> None:
    case = arm("arm3", 0)
    heavy = with_lump(case, 1.0)
    without = total(case, solved(case, objective=objective))
    assert max(abs(without - true_total(case)), abs(without - true_total(heavy))) > 10.0 * STD
    for one in (case, heavy):
        found = solved(one, weighed(true_total(one)), objective=objective)
        assert abs(total(one, found) - true_total(one)) < STD
        (known,) = found.known
        assert (known.name, known.given, known.given_std) == ("total", true_total(one), STD)
        assert known.mass == pytest.approx(total(one, found), abs=1e-9)
        assert 0.5 * STD < known.std < 1.5 * STD


@pytest.mark.parametrize("gamma", [1e-6, 1e-2])
def test_to_be_told_what_one_believes_changes_nothing(gamma: float) -> None:
    """A row without a residual leaves the minimum where it is, however precise: the prior is not made heavier."""
    case = arm("arm3", 1)
    before = solved(case, gamma=gamma)
    after = solved(case, weighed(total(case, before), 1e-3), gamma=gamma)
    np.testing.assert_allclose(after.parameters, before.parameters, rtol=1e-6, atol=1e-8)
    assert after.gamma == before.gamma == gamma


def test_a_scale_of_great_precision_is_obeyed() -> None:
    case = arm("arm3", 0)
    found = solved(case, weighed(true_total(case) + 0.3, 1e-5 * true_total(case)))
    assert total(case, found) == pytest.approx(true_total(case) + 0.3, abs=1e-4)
    assert found.converged


def test_live_and_from_a_bag_alike() -> None:
    """The node solves now and then while samples come; the last solve, for all data, is that of a bag."""
    case = arm("arm3", 5, seconds=10)
    truth, last = true_total(case), case.true.links[-1, 0]
    configuration = Configuration({"known": [f"total={truth}:0.05", f"link3={last}:0.01"], "gamma": 1e-4})
    bag, live = (Session(shipped("arm3"), configuration, "arm3.urdf") for _ in range(2))
    bag.identifier.add(case.samples)
    whole = bag.identifier.solve()
    for start in range(0, len(case.samples), 400):
        live.identifier.add(case.samples.select(slice(start, start + 400)))
        live.identifier.solve()
    pieces = live.identifier.solve()
    assert [known.name for known in whole.known] == ["total", "link3"]
    np.testing.assert_allclose(pieces.parameters, whole.parameters, rtol=1e-6, atol=1e-9)
    assert abs(total(case, pieces) - truth) < 0.05
    assert pieces.links[-1].mass == pytest.approx(last, abs=0.02)
