"""The recordings of the gap workflow: what is fitted, what is judged on, and what is simulated again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np

from geomid_ros.commands.gap_twin import check_twin
from geomid_ros.commands.recordings import Topics, check_efforts, read_samples
from geomid_ros.errors import InputError
from geomid_ros.files.bags import Bag
from geomid_ros.gap.library import effect_columns
from geomid_ros.gap.settings import CUTOFF
from geomid_ros.model.samples import Samples
from geomid_ros.resimulation.resimulate import CUTOFF as SHARP_CUTOFF
from geomid_ros.session import Session
from geomid_ros.signals.messages import MESSAGE_TYPES, stamp_of

_CUTOFF_PER_RATE = 0.4  # the highest cutoff, as a share of the messages' rate
_MESSAGES_FOR_RATE = 64


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

    def read(self, bags: Bags) -> Recordings:
        """All that the workflow needs. Raises InputError naming the bag."""
        if bags.simulated and len(bags.simulated) != len(bags.fitted):
            raise InputError(
                f"{len(bags.simulated)} recordings of a simulator for {len(bags.fitted)} bags: give --simulated once "
                "for each bag, in their order"
            )
        cutoff = self._cutoff([*bags.fitted, *bags.validate, *bags.simulated])
        whole = [self._whole(path, cutoff) for path in bags.fitted]
        twins = [self._whole(path, cutoff) for path in bags.simulated]
        for pair in zip(bags.simulated, twins, bags.fitted, whole, strict=False):
            check_twin(self.session, *pair)
        train = [samples.select(samples.stamps < _boundary(samples, bags.share)) for samples in whole]
        held_out = [samples.select(samples.stamps >= _boundary(samples, bags.share)) for samples in whole]
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
        cutoff = min(SHARP_CUTOFF, self._highest_cutoff([*bags.fitted, *bags.validate]))
        parts = [(path, bags.share) for path in bags.fitted if bags.share > 0.0] + [
            (path, 1.0) for path in bags.validate
        ]
        whole = [(self._whole(path, cutoff, topic), share) for path, share in parts]
        return [samples.select(samples.stamps >= _boundary(samples, share)) for samples, share in whole]

    def _whole(self, path: Path, cutoff: float, topic: str = "") -> Samples:
        settings = replace(self.session.configuration.signals(self.session.robot.joint_names), cutoff=cutoff)
        pipeline = self.session.new_pipeline(settings, effect_columns)
        topics = replace(self.topics, joint_states=topic, joint_option="--command") if topic else self.topics
        with Bag(path) as bag:
            return Samples.concatenate(list(read_samples(bag, self.session, pipeline, topics)))

    def _cutoff(self, paths: Sequence[Path]) -> float:
        """The low-pass of all recordings [Hz]: the configured one, or what their rates allow."""
        if "filter.cutoff" in self.session.configuration.given:
            return float(self.session.configuration["filter.cutoff"])
        return min(CUTOFF, self._highest_cutoff(paths))

    def _highest_cutoff(self, paths: Sequence[Path]) -> float:
        return _CUTOFF_PER_RATE * min(self._rate(path) for path in paths)

    def _rate(self, path: Path) -> float:
        """Joint messages per second at the beginning of a bag."""
        with Bag(path) as bag:
            topic = bag.find_topic(self.topics.joint_states, MESSAGE_TYPES["joint_states"], "--joint-topic")
            stamps = [stamp_of(m.header) for _, _, m in islice(bag.messages([topic]), _MESSAGES_FOR_RATE)]
        period = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
        return 1e9 / period if period > 0.0 else np.inf


def _boundary(samples: Samples, share: float) -> int:
    """The first stamp of the last ``share`` of the samples' time."""
    end = int(samples.stamps[-1]) + 1
    return end - round(share * (end - int(samples.stamps[0])))
