"""What is kept of a bag is all that an estimate needs of it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest

import geomid_ros
from geomid_ros.errors import InputError
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.fleet.recordings import FleetBag
from geomid_ros.fleet.work import BagSummary, FleetPlan, solve, sum_of_summaries, summarise
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Bags, Topics
from geomid_ros.session.session import Session, document
from geomid_ros.types import FloatArray

from .bags import URDF, piece

ROUNDING = 1e-10


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("bags")
    return [piece(folder / f"bag{index}", 2.5 * index) for index in range(3)]


@cache
def summary(*bags: Path) -> tuple[Session, BagSummary]:
    return summarise(read_urdf(URDF), str(URDF), Configuration(), Bags(fitted=bags))


def fresh() -> Session:
    return Session(read_urdf(URDF), Configuration(), str(URDF))


def products(found: BagSummary) -> FloatArray:
    """The products of all columns, targets included, over the folds, by group."""
    groups = zip(*found.fitted.summary.factors, strict=True)
    return np.concatenate([sum(factor.T @ factor for factor in folds).ravel() for folds in groups])


def test_the_sum_of_bags_is_that_of_one_identifier_in_any_order(bags: list[Path]) -> None:
    separate = [summary(bag)[1] for bag in bags]
    _, one = summary(*bags)
    for order in permutations(separate):
        found = sum_of_summaries(order)
        scale = np.max(np.abs(products(one)))
        np.testing.assert_allclose(products(found), products(one), atol=ROUNDING * scale, rtol=0.0)
        assert found.fitted.summary.rows == one.fitted.summary.rows
        assert found.fitted.summary.time == pytest.approx(one.fitted.summary.time, rel=1e-12)
        assert found.recorded.accounts == one.recorded.accounts


def test_one_bag_is_identified_as_geomid_identify_does(bags: list[Path]) -> None:
    expected = geomid_ros.identify(bags[0], URDF)
    session, kept = summary(bags[0])
    again = fresh()
    estimate, held_out, verdict = solve(again, BagSummary.decoded(kept.encoded(session), again))
    np.testing.assert_allclose(estimate.parameters, expected.estimate.parameters, rtol=1e-9)
    np.testing.assert_allclose(estimate.posterior.covariance, expected.estimate.posterior.covariance, rtol=1e-6)
    np.testing.assert_allclose(held_out, expected.held_out_rms, rtol=1e-9)
    assert verdict == expected.verdict
    found = document(again, estimate, held_out, verdict)
    assert found["messages"] == expected.document["messages"]
    assert found["warnings"] == expected.document["warnings"]
    assert found["rows"] == expected.document["rows"]


def test_several_bags_agree_with_geomid_identify_but_for_where_folds_are_cut(bags: list[Path]) -> None:
    """Folds begin anew in each bag: they decide on optional effects and on standard deviations, not on the rest."""
    bare = Configuration({"candidates": []})
    expected = geomid_ros.identify(bags, URDF, config=bare)
    text, source = read_urdf(URDF), str(URDF)
    separate = [summarise(text, source, bare, Bags(fitted=[bag]))[1] for bag in bags]
    estimate, held_out, verdict = solve(Session(text, bare, source), sum_of_summaries(separate))
    np.testing.assert_allclose(estimate.parameters, expected.estimate.parameters, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(held_out, expected.held_out_rms, rtol=1e-6)
    assert verdict.word == expected.verdict.word


def test_what_is_kept_is_read_again_or_refused(bags: list[Path]) -> None:
    session, kept = summary(bags[1])
    content = kept.encoded(session)
    again = BagSummary.decoded(content, fresh())
    np.testing.assert_array_equal(products(again), products(kept))
    assert again.recorded == kept.recorded
    assert (again.begin, again.end, again.locked) == (kept.begin, kept.end, kept.locked)
    for damaged in (content[:500], content[:-10], b""):
        with pytest.raises(InputError):
            BagSummary.decoded(damaged, fresh())
    other = Session(read_urdf(URDF), Configuration({"filter.cutoff": 3.0}), str(URDF))
    with pytest.raises(InputError, match=r"of another configuration: filter\.cutoff"):
        BagSummary.decoded(content, other)


def test_what_is_kept_is_called_by_all_that_it_depends_on() -> None:
    """Whatever differs makes another file: nothing is taken for what it is not."""
    plan = FleetPlan(description="<robot/>", source="a", given={}, topics=Topics("joint_states", "odom"))
    other, bag = replace(plan, given={"filter.cutoff": 3.0}), FleetBag("robot", "bag", "first")
    names = [of.summary_name(one) for of in (plan, other) for one in (bag, replace(bag, fingerprint="second"))]
    names += [of.results_name("robot", bags) for of in (plan, other) for bags in (names[:1], names[:2])]
    assert len(set(names)) == 8
    assert plan.results_name("robot", names[:2]) == plan.results_name("robot", names[1::-1])
