"""What the gap workflow reads of a bag: the whole for the search, and sharply what is simulated again."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from files.recordings import BAGS

from geomid_ros.estimation.estimate import UncertainInertia
from geomid_ros.files.bags.bag import Bag
from geomid_ros.files.models.urdf import read_urdf
from geomid_ros.model.samples import REST, SIGN, SMOOTH_SIGN, Samples
from geomid_ros.options import silent
from geomid_ros.resimulation.resimulate import CUTOFF
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.gap import (
    MESSAGES_FOR_RATE,
    GapReader,
    GapSamples,
    Identified,
    find_gap_in_samples,
    gap_pipeline,
    gap_session,
    message_rate,
)
from geomid_ros.session.recordings import Bags, Topics, read_samples, split_held_out
from geomid_ros.session.session import Session
from geomid_ros.signals.clocks import FEWEST
from geomid_ros.signals.kernels import LOWEST_RATE_PER_CUTOFF, derivative_kernels

BAG = BAGS / "arm3"
SHARE = 0.3


@pytest.fixture
def session() -> Session:
    return gap_session(read_urdf(BAGS / "arm3.urdf"), Configuration(), "arm3.urdf")


def test_what_is_simulated_again_is_the_end_that_is_held_out(session: Session) -> None:
    """Read with its own low-pass, and without the columns of the effects that are searched for."""
    (late,) = GapReader(session, Bags(fitted=[BAG], hold_out=SHARE)).high_cutoff_samples()
    pipeline = gap_pipeline(session, min(CUTOFF, 100.0 / LOWEST_RATE_PER_CUTOFF))
    with Bag(BAG) as bag:
        everything = list(read_samples(bag, session, pipeline, Topics("joint_states", "odom")))
    _, expected = split_held_out(Samples.concatenate(everything), SHARE)
    np.testing.assert_array_equal(late.stamps, expected.stamps)
    for name in ("position", "velocity", "acceleration", "effort"):
        own = expected.arrays[name]
        np.testing.assert_allclose(late.arrays[name], own, rtol=0.0, atol=1e-9 * np.max(np.abs(own)))
    assert set(late.entries.columns) == {SIGN, SMOOTH_SIGN, REST}


def test_the_highest_cutoff_is_one_that_every_part_of_a_recording_allows() -> None:
    """Stamps jitter by a twentieth of their period; the pipeline infers it from others than the reader does."""
    rng = np.random.default_rng(1)
    for _ in range(200):
        stamps = np.cumsum(20_000_000 + 1_000_000 * rng.normal(size=(2, MESSAGES_FOR_RATE)), axis=1).astype(np.int64)
        chosen = message_rate(stamps[0].tolist()) / LOWEST_RATE_PER_CUTOFF
        derivative_kernels(chosen, 1e-9 * float(np.median(np.diff(stamps[1, :FEWEST]))))


def test_masses_that_identify_does_not_contradict_are_the_descriptions(session: Session) -> None:
    nominal = session.model.nominal_inertias[::10]
    off = np.array([0.0, 1.9, -2.1])
    bodies = np.column_stack([nominal + 0.3 * off, np.zeros((3, 9))])
    links = [UncertainInertia(parameters=body, std=np.full(10, 0.3)) for body in bodies]
    estimate: Any = SimpleNamespace(links=links)
    assert Identified(session, estimate).usual_masses == [0, 1]


def test_the_workflow_holds_them(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    given: dict[str, Any] = {}
    monkeypatch.setattr("geomid_ros.session.gap.find_gap", lambda *_, **options: given.update(options))
    identified: Any = SimpleNamespace(effects={}, usual_masses=[1])
    find_gap_in_samples(session, GapSamples(cutoff=8.0, train=[], held_out=[]), None, identified, silent)
    assert given["masses_held"] == [1]


def test_recordings_are_judged_as_a_whole(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is kept of a long one to find a delay depends on how much comes at once."""
    monkeypatch.setattr("geomid_ros.model.samples.SAMPLES_PER_PIECE", 100)
    judged: list[int] = []
    monkeypatch.setattr(session.review.check, "add", lambda samples: judged.append(len(samples)))
    found = GapReader(session, Bags(fitted=[BAG], hold_out=SHARE)).read(())
    assert judged == [sum(map(len, (*found.train, *found.held_out)))]
