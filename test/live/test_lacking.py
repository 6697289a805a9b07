"""What an estimate of a live session leaves unexplained is kept beside it, and is no change."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from estimation.arms import efforts, motion, shipped, truth

from geomid_ros.errors import InputError
from geomid_ros.files.models.posterior import POSTERIOR, read_posterior, read_remainder
from geomid_ros.gap.features import KnownRemainder
from geomid_ros.live import saving as module
from geomid_ros.live.saving import Saving
from geomid_ros.live.searches import look_for_gap
from geomid_ros.live.worker import Worker
from geomid_ros.model.channels import Channel
from geomid_ros.model.robot import Robot
from geomid_ros.monitoring.change_detection import ChangeDetector, ChannelGap
from geomid_ros.options import silent
from geomid_ros.session import gap
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.gap import identified_session, remainder_in_messages
from geomid_ros.session.session import Session
from geomid_ros.signals.messages import JOINT_STATES, AcceptedMessages, Recent

NOISE, RIPPLE, WAVES = 0.02, 0.5, 14.0  # [N m], [N m] and per radian, at joint2
PATIENCE = 600.0  # [s]


class Rippling:
    """A small arm whose second gear ripples, which nothing in its model has a name for."""

    def __init__(self) -> None:
        self.session = Session(shipped("arm3"), Configuration({"candidates": []}), "arm3.urdf")
        robot, rng = Robot(shipped("arm3")), np.random.default_rng(5)
        moving = motion(rng, len(robot.joints), 60.0)
        measured = efforts(robot, truth(rng, robot), moving)
        measured[:, 1] += RIPPLE * np.sin(WAVES * moving.position[:, 1])
        measured += NOISE * rng.normal(size=measured.shape)
        stamps = 10_000_000 * np.arange(1, len(measured) + 1)
        self.messages = [
            AcceptedMessages(JOINT_STATES, stamps, np.hstack([moving.position, moving.velocity, measured]))
        ]
        self.session.recent(self.messages[0])
        pipeline = self.session.new_pipeline()
        pipeline.push_accepted(self.messages[0])
        samples = pipeline.collect()
        assert samples is not None
        self.session.identifier.add(samples)
        self.estimate = self.session.identifier.solve()

        self.worker: Any = SimpleNamespace(session=self.session)  # as much of one as saving asks


@pytest.fixture(scope="module")
def arm() -> Rippling:
    return Rippling()


@pytest.fixture
def saving(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Saving:
    """In no thread."""
    monkeypatch.setattr(module, "start_daemon", lambda _, act, *arguments: act(*arguments))
    return Saving(str(tmp_path))


@pytest.mark.parametrize("remembered", [True, False])
def test_a_search_is_told_what_the_estimate_lacked(
    arm: Rippling, monkeypatch: pytest.MonkeyPatch, remembered: bool
) -> None:
    """The second gear ripples, the others do not."""
    told: list[KnownRemainder | None] = []

    def search(*_: object, known_remainder: KnownRemainder | None, **__: object) -> None:
        told.append(known_remainder)
        raise InputError("not searched")

    monkeypatch.setattr(gap, "find_gap", search)
    with pytest.raises(InputError, match="not searched"):
        look_for_gap(arm.session, arm.estimate, arm.messages if remembered else [], arm.messages, silent)
    (standing,) = told
    assert (standing is not None) == remembered
    if standing is not None:
        first, second, third = (float(np.linalg.norm(mean)) for mean in standing.means)
        assert second > 5.0 * max(first, third)


def test_it_is_saved_after_the_answer_and_is_of_all_messages_that_the_estimate_is_from(
    arm: Rippling, saving: Saving, tmp_path: Path
) -> None:
    """Whether a gap is open or not."""
    path, answers = tmp_path / POSTERIOR, list[Any]()
    saving.begin(arm.worker, arm.estimate, lambda answer: answers.append((answer[0], read_remainder(path))))
    assert answers == [(True, None)]
    (whole,) = arm.messages
    saved = identified_session(arm.session, arm.estimate)
    expected = remainder_in_messages(saved, arm.messages)
    other = remainder_in_messages(saved, [whole.before(int(whole.stamps[len(whole) // 2]))])
    found = read_remainder(path)
    assert expected is not None
    assert other is not None
    assert found is not None
    assert found.channels == ("joint1", "joint2", "joint3")
    for mean, own in zip(found.means, expected.means, strict=True):
        np.testing.assert_allclose(mean, own, rtol=1e-9, atol=1e-12)
    assert not np.allclose(found.means[1], other.means[1], rtol=1e-3)


def test_it_is_not_given_to_another_estimate(
    arm: Rippling, saving: Saving, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That was saved meanwhile."""
    other = arm.session.identifier.solve()

    def save_other() -> list[AcceptedMessages]:
        saving.save_last(arm.session, other).result(PATIENCE)
        return arm.messages

    monkeypatch.setattr(arm.session.recent, "entries", save_other)
    saving.begin(arm.worker, arm.estimate, lambda _: None)
    assert read_posterior(tmp_path / POSTERIOR).parameters.tolist() == other.posterior.parameters.tolist()
    assert read_remainder(tmp_path / POSTERIOR) is None


SECOND = 10**9  # [ns]


@pytest.mark.parametrize("set_back", [False, True])
@pytest.mark.parametrize(
    ("opened", "before", "after"), [((None, 70), 69, 29), ((70, 40), 39, 29), ((None, None), 100, 100)]
)
def test_messages_before_and_after_a_gap(
    opened: tuple[int | None, int | None], before: int, after: int, set_back: bool
) -> None:
    """That opened first, and last; all of them without one, and after it if the clock was set back since."""
    recent = Recent(200.0, lambda: 500)
    for begin in (SECOND // 2, 0) if set_back else (0,):
        recent(AcceptedMessages(JOINT_STATES, begin + SECOND * np.arange(1, 101), np.zeros((100, 9))))
    detector = ChangeDetector([Channel(name="joint", unit="N m", columns=np.arange(1))])
    stamps = [None if since is None else since * SECOND for since in opened]
    detector.gaps = tuple(ChannelGap(f"joint{place}", 3.0, since, 499) for place, since in enumerate(stamps))
    own: Any = object.__new__(Worker)
    own.session, own.solver = SimpleNamespace(recent=recent), SimpleNamespace(detector=detector)
    if set_back and any(opened):
        before, after = 0, 100
    assert sum(map(len, own.messages_before_gap())) == before
    assert sum(map(len, own.recent_messages())) == after
