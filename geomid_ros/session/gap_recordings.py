"""The recordings of the gap workflow: what is fitted, what is judged on, and what is simulated again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

from geomid_ros.errors import InputError
from geomid_ros.files.bags.bag import Bag
from geomid_ros.model.samples import Samples
from geomid_ros.resimulation.resimulate import CUTOFF as SHARP_CUTOFF
from geomid_ros.session.gap import CUTOFF_PER_RATE, MESSAGES_FOR_RATE, divided, gap_cutoff, gap_pipeline, rate
from geomid_ros.session.gap_twin import check_twin
from geomid_ros.session.recordings import Topics, Tracked, check_efforts, read_samples, untracked
from geomid_ros.session.session import Session
from geomid_ros.signals.messages import JOINT_STATES, message_type, parse


@dataclass(frozen=True)
class Bags:
    """Bags to fit, the last ``share`` of each being judged on; others to judge on; and of the user's simulator, one for
    each of the former or none."""

    fitted: Sequence[Path]
    share: float
    validate: Sequence[Path]
    simulated: Sequence[Path]


@dataclass(frozen=True)
class Recordings:
    """Samples, one element per bag, with a low-pass of ``cutoff`` [Hz].

    ``train`` is fitted, ``held_out`` judged on, ``simulated`` is what the user's simulator did.
    """

    cutoff: float
    train: Sequence[Samples]
    held_out: Sequence[Samples]
    simulated: Sequence[Samples]


@dataclass(frozen=True)
class Reader:
    """Reads bags for a session from these topics."""

    session: Session
    topics: Topics
    tracked: Tracked = untracked

    def read(self, bags: Bags) -> Recordings:
        """All that the workflow needs. Raises InputError naming the bag."""
        if bags.simulated and len(bags.simulated) != len(bags.fitted):
            raise InputError(
                f"{len(bags.simulated)} recordings of a simulator for {len(bags.fitted)} bags: give --simulated once "
                "for each bag, in their order"
            )
        cutoff = gap_cutoff(self.session, self._rate([*bags.fitted, *bags.validate, *bags.simulated]))
        whole = [self._whole(path, cutoff) for path in bags.fitted]
        twins = [self._whole(path, cutoff) for path in bags.simulated]
        for pair in zip(bags.simulated, twins, bags.fitted, whole, strict=False):
            check_twin(self.session, *pair)
        parts = [divided(samples, bags.share) for samples in whole]
        train, held_out = [part for part, _ in parts], [part for _, part in parts]
        held_out += [self._whole(path, cutoff) for path in bags.validate]
        check_efforts(self.session, train, bags.fitted)
        if not any(map(len, held_out)):
            raise InputError(
                "nothing to judge on: hold out a part of the bags with --hold-out, or name others with --validate"
            )
        return Recordings(cutoff, train, [samples for samples in held_out if len(samples)], twins)

    def sharp(self, bags: Bags, topic: str = "") -> list[Samples]:
        """What is judged on with as high a cutoff as its rate allows; of ``topic``, if given, instead of the joint
        states."""
        cutoff = min(SHARP_CUTOFF, CUTOFF_PER_RATE * self._rate([*bags.fitted, *bags.validate]))
        parts = [(path, bags.share) for path in bags.fitted if bags.share > 0.0] + [
            (path, 1.0) for path in bags.validate
        ]
        return [divided(self._whole(path, cutoff, topic), share)[1] for path, share in parts]

    def _whole(self, path: Path, cutoff: float, topic: str = "") -> Samples:
        pipeline = gap_pipeline(self.session, cutoff)
        topics = replace(self.topics, joint_states=topic, joint_option="--command") if topic else self.topics
        with Bag(path) as bag:
            return Samples.concatenate(list(read_samples(bag, self.session, pipeline, topics, self.tracked)))

    def _rate(self, paths: Sequence[Path]) -> float:
        """Joint messages per second at the beginning of the slowest bag."""
        return min(rate(self._first_stamps(path)) for path in paths)

    def _first_stamps(self, path: Path) -> list[int]:
        with Bag(path) as bag:
            topic = bag.find_topic(self.topics.joint_states, message_type(JOINT_STATES), "--joint-topic")
            return [parse(JOINT_STATES, m).stamp for _, _, m in islice(bag.messages([topic]), MESSAGES_FOR_RATE)]
