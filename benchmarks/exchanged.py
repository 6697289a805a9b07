"""Held-out errors when recordings exchange their roles: where the choice of effects fails on motions it has not seen.

Reads the recordings of :mod:`benchmarks.measured_data`, each once, and fits parts of them:

    python -m benchmarks.exchanged [SET ...] [--before before.json] [--out after.json]

A recording's halves train for each other, each of its thirds is tested on the other two, its slow windows train for its
fast ones, and bags swap their roles. Every split is solved with the effects that ``identify`` chooses and with none of
them. A ratio above 1 to "none" is a split on which the choice did harm. What both halves of a recording say of an
effect is compared: intervals that are right overlap as often as they state.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from benchmarks.measured_data import CASES, DATA, Case
from geomid_ros.api.robot import configuration, description, topics
from geomid_ros.estimation.estimate import STDS_OF_95, Estimate
from geomid_ros.files.bags.bag import Bag
from geomid_ros.model.effects import DEFAULT_CANDIDATES
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.options import RecordingOptions
from geomid_ros.session.recordings import Training, read_samples, read_with_locked
from geomid_ros.session.session import Session
from geomid_ros.types import IntArray

SETS = tuple(name for name in CASES if name != "human")
_WINDOW = 2.0  # [s]
_FASTER = (1.3, 20.0)  # factors between the median speeds of slow and fast windows: none differ, the slow ones rest
_UNSURE = 2.0  # standard deviations
_ONE_HALF, _OTHER_HALF = "1st half -> 2nd", "2nd half -> 1st"

Parts: TypeAlias = tuple[Samples, ...]


@dataclass(frozen=True, eq=False)
class Split:
    """Samples to fit and to test on, and how they were divided."""

    name: str
    train: Parts
    test: Parts


@dataclass(frozen=True, eq=False)
class Robot:
    """The robot of a measured set, identified with ``candidates`` for its effects, or with the default ones alone."""

    case: Case
    candidates: bool

    def read(self) -> tuple[dict[str, Samples], Configuration]:
        """The samples ``(N,)`` of each bag, and the configuration that they were read with."""

        def read(session: Session) -> dict[str, Samples]:
            found = {}
            for name in (*self.case.train, *self.case.validate):
                with Bag(DATA / name) as bag:
                    batches = list(read_samples(bag, session, session.new_pipeline(), topics(self._options)))
                found[Path(name).name] = Samples.concatenate(batches)
            return found

        given = configuration(self._options, **({} if self.candidates else {"candidates": []}))
        session, recordings = read_with_locked(self.session, given, read)
        return recordings, session.configuration

    def session(self, configuration: Configuration) -> Session:
        """A session that has read nothing."""
        robot = description(self._options, [DATA / self.case.train[0]])
        return Session(robot.text, configuration, robot.source)

    @property
    def _options(self) -> RecordingOptions:
        options = {name: value for name, value in self.case.options.items() if name != "hold_out"}
        return RecordingOptions(urdf=self.case.description, **options)


def splits(recordings: dict[str, Samples]) -> Iterator[Split]:
    """All splits of a set's recordings."""
    if len(recordings) > 1:
        for name, samples in recordings.items():
            others = {other: each for other, each in recordings.items() if other != name}
            yield Split(f"{' + '.join(others)} -> {name}", tuple(others.values()), (samples,))
    for name, samples in recordings.items():
        first, second = _parts(samples, 2)
        yield Split(f"{name}: {_ONE_HALF}", (first,), (second,))
        yield Split(f"{name}: {_OTHER_HALF}", (second,), (first,))
        thirds = _parts(samples, 3)
        for number, test in enumerate(thirds):
            train = tuple(part for place, part in enumerate(thirds) if place != number)
            yield Split(f"{name}: third {number + 1} held out", train, (test,))
        yield from _by_speed(name, samples)


def _parts(samples: Samples, count: int) -> Parts:
    """Consecutive parts of equal time."""
    places = _windows(samples, count)
    return tuple(samples.select(places == number) for number in range(count))


def _windows(samples: Samples, count: int) -> IntArray:
    """The number of the window ``(N,)`` of equal time that each instant is in."""
    elapsed = samples.stamps - samples.stamps[0]
    result: IntArray = np.minimum(count * elapsed // (elapsed[-1] + 1), count - 1)
    return result


def _by_speed(name: str, samples: Samples) -> Iterator[Split]:
    """The slower half of a recording's windows for the faster one, if they differ."""
    seconds = 1e-9 * float(samples.stamps[-1] - samples.stamps[0])
    count = round(seconds / _WINDOW)
    if count < 2:
        return
    window = _windows(samples, count)
    squares = np.sum(np.concatenate([samples.velocity, samples.base_velocity], axis=1) ** 2, axis=1)
    speeds = np.sqrt([np.mean(squares[window == number]) for number in range(count)])
    order = np.argsort(speeds)
    slow, fast = order[: count // 2], order[count // 2 :]
    least, most = _FASTER
    if not least * np.median(speeds[slow]) < np.median(speeds[fast]) < most * np.median(speeds[slow]):
        return
    train = tuple(samples.select(window == number) for number in np.sort(slow))
    yield Split(f"{name}: slow -> fast", train, tuple(samples.select(window == number) for number in np.sort(fast)))


@dataclass(frozen=True)
class Row:
    """The result of one split: ``total`` is the sum over channels of the RMS on its test part, ``none`` the same
    without optional effects; ``effects`` counts the optional ones that were taken, ``unsure`` those of them that are
    smaller than twice their own standard deviation, ``negative`` those that are a negative Stribeck excess. Of the
    ``common`` effects, which both halves of a recording have, ``agreeing`` differ by no more than 95 % of such pairs
    do."""

    total: float
    none: float
    effects: int
    unsure: int
    negative: int
    seconds: float
    common: int = 0
    agreeing: int = 0


def agreement(one: Estimate, other: Estimate) -> tuple[int, int]:
    """Number of effects that both estimates have, and of those whose difference may be chance."""
    values = {(effect.name, effect.joint, *effect.parameters): effect for effect in one.effects}
    pairs = [(values[key], own) for own in other.effects if (key := (own.name, own.joint, *own.parameters)) in values]
    agreeing = [abs(a.value - b.value) < STDS_OF_95 * np.hypot(a.std, b.std) for a, b in pairs]
    return len(pairs), int(sum(agreeing))


def solved(session: Session, split: Split) -> tuple[float, Estimate]:
    """Sum over channels of the RMS on the test part, and the estimate from the other."""
    training = Training(session)
    for samples in split.train:
        training.add(samples)
    estimate = session.identifier.solve()
    return float(np.nansum(session.rms(split.test, *estimate.predictor))), estimate


def rows(names: Iterable[str]) -> Iterator[tuple[str, Row]]:
    """The result of every split of these sets, by name."""
    for name in names:
        chosen, bare = (Robot(CASES[name], candidates) for candidates in (True, False))
        recordings, configuration = chosen.read()
        recordings_of_bare, bare_configuration = bare.read()
        half: Estimate | None = None
        for split, without in zip(splits(recordings), splits(recordings_of_bare), strict=True):
            begin = time.process_time()
            total, estimate = solved(chosen.session(configuration), split)
            seconds = time.process_time() - begin
            none, _ = solved(bare.session(bare_configuration), without)
            optional = [effect for effect in estimate.effects if effect.name in DEFAULT_CANDIDATES]
            unsure = sum(abs(effect.value) < _UNSURE * effect.std for effect in optional)
            negative = sum(effect.name == "stribeck_friction" and effect.value < 0.0 for effect in optional)
            both = agreement(half, estimate) if half is not None and split.name.endswith(_OTHER_HALF) else (0, 0)
            half = estimate if split.name.endswith(_ONE_HALF) else None
            yield f"{name} {split.name}", Row(total, none, len(optional), unsure, negative, seconds, *both)


def summary(found: dict[str, Row], before: dict[str, dict[str, float]]) -> Iterator[str]:
    """Geometric means and worst ratios against no optional effects and against an earlier run, in sentences."""
    against = {"no optional effects": {name: row.total / row.none for name, row in found.items()}}
    if before:
        against["before"] = {name: row.total / before[name]["total"] for name, row in found.items() if name in before}
    for reference, ratios in against.items():
        worst = max(ratios, key=lambda name: ratios[name])
        by_set: dict[str, list[float]] = {}
        for name, ratio in ratios.items():
            by_set.setdefault(name.split()[0], []).append(float(np.log(ratio)))
        over_splits = np.exp(np.mean(np.concatenate(list(by_set.values()))))
        over_sets = np.exp(np.mean([np.mean(logs) for logs in by_set.values()]))
        yield (
            f"against {reference}: geometric mean {over_splits:.3f} over {len(ratios)} splits, {over_sets:.3f} over "
            f"sets; worst {ratios[worst]:.3f} ({worst})"
        )
    effects, unsure, negative = (
        sum(getattr(row, name) for row in found.values()) for name in ("effects", "unsure", "negative")
    )
    yield f"{effects} optional effects, {unsure} below {_UNSURE:g} of their own std; {negative} negative Stribeck"
    common, agreeing = (sum(getattr(row, name) for row in found.values()) for name in ("common", "agreeing"))
    share = f" ({100.0 * agreeing / common:.0f} %)" if common else ""
    yield f"95 % intervals of {agreeing} of {common} effects agree between the halves of a recording{share}"


def main() -> None:
    """Print a line per split as it is solved, then the summary."""
    if not DATA.is_dir():
        sys.exit(f"the measured recordings are not there: {DATA}")
    parser = argparse.ArgumentParser(prog="python -m benchmarks.exchanged", description=__doc__)
    parser.add_argument("sets", nargs="*", metavar="SET", help=f"of {', '.join(SETS)}; all unless given")
    parser.add_argument("--out", type=Path, help="file for the figures (JSON)")
    parser.add_argument("--before", type=Path, help="figures of an earlier run to compare with")
    arguments = parser.parse_args()
    before = json.loads(arguments.before.read_text()) if arguments.before else {}
    found: dict[str, Row] = {}
    table = Table(box=box.SIMPLE_HEAD)
    for heading in ("split", "total", "none", "ratio", "before", "effects", "unsure", "s"):
        table.add_column(heading, justify="left" if heading == "split" else "right", no_wrap=True)
    for name, row in rows(arguments.sets or SETS):
        found[name] = row
        old = f"{before[name]['total']:.4g}" if name in before else ""
        counts = (str(row.effects), str(row.unsure), f"{row.seconds:.1f}")
        table.add_row(name, f"{row.total:.4g}", f"{row.none:.4g}", f"{row.total / row.none:.3f}", old, *counts)
        print(f"{name}: {row.total:.4g}, none {row.none:.4g}, {row.effects} effects", file=sys.stderr, flush=True)
        if arguments.out:
            arguments.out.write_text(json.dumps({key: asdict(each) for key, each in found.items()}, indent=2))
    Console(width=140).print(table)
    print("\n".join(summary(found, before)))


if __name__ == "__main__":
    main()
