"""The subset of the benches on which numbers are tried. Recordings are read once, before any number is changed."""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.ablation.running import Case, Figures
from benchmarks.blind.case import robot_file
from benchmarks.blind.realistic.case import draw
from benchmarks.corruption.faults import FAULTS
from benchmarks.corruption.recording import SOURCES, Recording
from benchmarks.dry_friction import KINDS, Arm
from benchmarks.exchanged import SETS, Robot
from benchmarks.measured_data import CASES, DATA
from benchmarks.posterior import true_parameters
from benchmarks.simulated_arm import Run, arm, noise, truth
from geomid_ros.estimation.estimate import Estimate
from geomid_ros.files.bags.bag import Bag, RawMessage
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.model.effects import DEFAULT_EFFECTS
from geomid_ros.model.measurement_model import Rows
from geomid_ros.model.samples import Samples
from geomid_ros.monitoring.change_detection import BLOCK, ChangeDetector
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.gap import (
    GapSamples,
    find_gap_in_samples,
    gap_cutoff,
    gap_pipeline,
    gap_session,
    identified_in,
    message_rate,
)
from geomid_ros.session.recordings import HELD_OUT, Topics, Training, read_samples, split_held_out
from geomid_ros.session.review import faulty_streams
from geomid_ros.session.session import Session
from geomid_ros.simulation.description import robot_description
from geomid_ros.simulation.options import SimulationOptions
from geomid_ros.simulation.recording import simulate

_FOLDER = Path("out/ablation")
_CHOSEN = ("ur10", "lwr4", "tx40")  # identified with optional effects, too; the choice takes most of the time
_PLANTED = ("arm7", "ur10")  # recordings that faults are planted in
_REALISTIC, _CLEAN, _FRICTION, _WATCHED = (1, 3), (1, 2), (1,), (0, 1)  # seeds
_TOPICS = Topics("joint_states", "odom")
_SECONDS = 60.0  # of a watched motion; the robot changes in the middle
_BATCH, _READ = 500, 4000  # messages
_LOAD = slice(60, 70)  # the parameters of the last link


def cases(package: str) -> Iterator[Case]:
    """The cases for the numbers of a package."""
    every = {
        "estimation": (_measured, _simulated),
        "signals": (_faults, _read),
        "monitoring": (_watched, _wrenches),
        "checks": (_judged, _judged_faults),
        "inference": (_gaps,),
        "gap": (_gaps,),
    }
    for family in every[package]:
        yield from family()


class Kept(Bag):
    """A bag whose first messages are in memory."""

    def __init__(self, path: Path, most: int | None = None) -> None:
        super().__init__(path)
        messages = [message for batch in super().batches(list(self.topics)) for message in batch]
        self._batches = [messages[begin : begin + _BATCH] for begin in range(0, len(messages[:most]), _BATCH)]

    def batches(self, topics: Collection[str]) -> Iterator[list[RawMessage]]:
        """As they were read."""
        for batch in self._batches:
            yield [message for message in batch if message.topic in topics]


def _estimated(estimate: Estimate, held_out: float) -> Figures:
    """What is said of a robot: numbers, and what can be told."""
    told = {link.name: link.identified for link in estimate.links}
    deviations = [np.log(link.std_mass / link.mass) for link in estimate.links]
    coefficients = [np.log(effect.std) for effect in estimate.effects if 0.0 < effect.std < np.inf]
    optional = sorted((e.name, e.joint) for e in estimate.effects if e.name not in DEFAULT_EFFECTS)
    return {
        "held out": held_out,
        "deviations of masses": float(np.exp(np.mean(deviations))),
        "deviations of effects": float(np.exp(np.mean(coefficients))) if coefficients else 0.0,
        "identified": str(told),
        "effects": str(optional),
        "warnings": f"{len(estimate.warnings)} {estimate.converged}",
    }


def _solve(session: Session, train: Sequence[Samples], test: Sequence[Samples]) -> tuple[Estimate, float]:
    training = Training(session)
    for samples in train:
        training.add(samples)
    estimate = session.identifier.solve()
    return estimate, float(np.nansum(session.rms(test, *estimate.predictor)))


def _measured() -> Iterator[Case]:
    """Measured sets: fitted and held out as in :mod:`benchmarks.measured_data`."""
    for name in SETS:
        for chosen in (False, True) if name in _CHOSEN else (False,):
            robot = Robot(CASES[name], candidates=chosen)
            recordings, configuration = robot.read()
            whole = [recordings[Path(bag).name] for bag in CASES[name].train]
            test = [recordings[Path(bag).name] for bag in CASES[name].validate]
            train = whole if test else [split_held_out(each, HELD_OUT)[0] for each in whole]
            test = test or [split_held_out(each, HELD_OUT)[1] for each in whole]

            def run(
                robot: Robot = robot, configuration: Configuration = configuration, parts: Any = (train, test)
            ) -> Figures:
                return _estimated(*_solve(robot.session(configuration), *parts))

            bench = "measured, effects chosen" if chosen else "measured"
            yield Case(bench, name, run)


@dataclass(frozen=True, eq=False)
class _Simulated:
    """A simulated robot that is identified."""

    urdf: str
    train: Samples
    test: Samples
    truth: dict[str, Any]
    candidates: bool

    @staticmethod
    def read(urdf: str, bag: Path, candidates: bool) -> _Simulated:
        session = _session(urdf, candidates)
        whole = _samples(session, Kept(bag))
        train, test = split_held_out(whole, HELD_OUT)
        true = json.loads(bag.with_name(f"{bag.name}.truth.json").read_text(encoding="utf-8"))
        return _Simulated(urdf, train, test, true, candidates)

    def run(self) -> Figures:
        estimate, held_out = _solve(_session(self.urdf, self.candidates), [self.train], [self.test])
        posterior = estimate.posterior
        error = posterior.coordinates(true_parameters(posterior, self.truth, self.urdf, ()))
        distance = float(np.mean(error**2 / np.diag(posterior.covariance)))
        return {**_estimated(estimate, held_out), "errors in deviations": distance}


def _session(urdf: str, candidates: bool) -> Session:
    return Session(urdf, Configuration({} if candidates else {"candidates": []}), "a simulated robot")


def _samples(session: Session, bag: Kept) -> Samples:
    return Samples.concatenate(list(read_samples(bag, session, session.new_pipeline(), _TOPICS)))


def _simulated() -> Iterator[Case]:
    """Dry friction of each kind with the effects chosen; clean and realistic robots with the default effects."""
    for kind in KINDS:
        for seed in _FRICTION:
            bag, _ = Arm.drawn(kind, seed).recorded()
            own = _Simulated.read(robot_description("arm7"), bag, candidates=True)
            yield Case("dry friction", f"{kind} {seed}", own.run)
    for name, urdf, bag in _recorded():
        yield Case("simulated", name, _Simulated.read(urdf, bag, candidates=False).run)


def _recorded() -> Iterator[tuple[str, str, Path]]:
    """Names, descriptions and bags of clean and realistic robots."""
    options = {f"clean {seed}": SimulationOptions(robot="arm3", seed=seed) for seed in _CLEAN}
    options |= {f"realistic {seed}": draw(seed).was for seed in _REALISTIC}
    for name, own in options.items():
        bag = _FOLDER / name.replace(" ", "_")
        robot = robot_file(own.robot)
        if not bag.with_name(f"{bag.name}.truth.json").exists():
            _FOLDER.mkdir(parents=True, exist_ok=True)
            simulate(bag, replace(own, robot=robot))
        yield name, robot_description(robot), bag


def _accounts(session: Session) -> Figures:
    """What the ledger says of the messages."""
    topics = session.pipeline.ledger.topics
    counts = {
        f"{topic} {what} {_words(reason)}": float(count)
        for topic, account in topics.items()
        for what, counter in (("rejected", account.rejected), ("noted", account.noted))
        for reason, count in counter.items()
    }
    sentences = [_words(finding.sentence) for finding in faulty_streams(topics, {})]
    return {**counts, "reasons": str(sorted(counts)), "doubts": str(sorted(sentences))}


def _words(sentence: str) -> str:
    """A sentence without its numbers."""
    return re.sub(r"\d[\d.e+-]*", "#", sentence)


def _sizes(samples: Samples) -> Figures:
    arrays = ("position", "velocity", "acceleration", "effort", "wrenches")
    sizes = {name: np.nanstd(getattr(samples, name)) for name in arrays if np.isfinite(getattr(samples, name)).any()}
    return {"samples": float(len(samples)), **{name: float(size) for name, size in sizes.items()}}


def _read() -> Iterator[Case]:
    """Measured sets, from messages to the estimate without optional effects."""
    for name in SETS:
        case = CASES[name]
        robot = Robot(case, candidates=False)
        bags = [Kept(DATA / bag, _READ) for bag in (*case.train, *case.validate)]
        _, configuration = robot.read()

        def run(robot: Robot = robot, configuration: Configuration = configuration, bags: list[Kept] = bags) -> Figures:
            session = robot.session(configuration)
            sizes, train, test = Figures(), list[Samples](), list[Samples]()
            for place, bag in enumerate(bags):
                pipeline = session.new_pipeline()
                whole = Samples.concatenate(list(read_samples(bag, session, pipeline, _TOPICS)))
                session.pipeline.ledger.add(pipeline.ledger.topics)
                sizes |= {f"{key} {place}": size for key, size in _sizes(whole).items()}
                early, late = split_held_out(whole, HELD_OUT)
                train, test = [*train, early], [*test, late]
            return {**sizes, **_accounts(session), "held out": _solve(session, train, test)[1]}

        yield Case("read", name, run)


@dataclass(frozen=True, eq=False)
class _Planted:
    """A recording with a fault in it."""

    recording: Recording
    bag: Kept

    def session(self) -> Session:
        source = self.recording.source
        configuration = Configuration(dict(source.settings))
        if source.wrench:
            configuration = configuration.with_sensors([WrenchSensor.parse(source.wrench)])
        return Session(self.recording.urdf, configuration, str(source.urdf))

    def read(self) -> Figures:
        session = self.session()
        pipeline = session.new_pipeline(ledger=session.pipeline.ledger)
        samples = Samples.concatenate(list(read_samples(self.bag, session, pipeline, _TOPICS)))
        return {**_sizes(samples), **_accounts(session)}


def _planted(recording: Recording, fault: Any, size: Any) -> _Planted:
    planted = fault.plant(recording, size)
    with tempfile.TemporaryDirectory(prefix="ablation-") as folder:
        return _Planted(planted, Kept(planted.write(Path(folder) / "bag")))


def _faults() -> Iterator[Case]:
    """Faults of single messages and of streams."""
    recording = Recording.read(SOURCES["arm7"])
    for fault in FAULTS:
        if fault.noted or fault.kind == "stream":
            for size in fault.sizes:
                yield Case("faults", f"{fault.name} {size}", _planted(recording, fault, size).read)


def _wrenches() -> Iterator[Case]:
    """Faults of a wrench sensor."""
    recording = Recording.read(SOURCES["arm7"])
    for fault in (fault for fault in FAULTS if fault.wrench):
        for size in fault.sizes:
            planted = _planted(recording, fault, size)
            session = planted.session()
            samples = _samples(session, planted.bag)

            def run(planted: _Planted = planted, samples: Samples = samples) -> Figures:
                session = planted.session()
                training = Training(session)
                training.add(samples)
                training.end()
                return {"said": _words("; ".join(finding.sentence for finding in session.review.findings))}

            yield Case("wrenches", f"{fault.name} {size}", run)


def _watched() -> Iterator[Case]:
    """The change detector on an arm that stays as it is, whose friction grows, and that gets a load."""
    for seed in _WATCHED:
        for what in ("quiet", "friction", "load"):
            yield Case("watched", f"{what} {seed}", partial(_watch, what, seed))


def _watch(what: str, seed: int) -> Figures:
    first, second = arm(seed, _SECONDS), arm(seed + 2, _SECONDS)
    run = Run(seed, correlated=True, uneven=False)
    detector = ChangeDetector(first.model.channels)
    true = truth(first, run)
    errors = np.concatenate([noise(first, run), noise(second, replace(run, seed=seed + 100))])
    coefficients = np.concatenate([first.coefficients, second.coefficients])
    changed = true.copy()
    if what == "friction":
        columns = [c.effect.name == "coulomb_friction" for c in first.model.coefficients]
        changed[len(true) - len(columns) :][columns] *= 1.5
    if what == "load":
        changed[_LOAD] *= 1.5
    count = len(coefficients)
    parameters = np.where(np.arange(count)[:, None] < count // 2, true, changed)
    targets = np.einsum("ncd,nd->nc", coefficients, parameters) + errors
    opened: dict[str, int] = {}
    for begin in range(0, count - BLOCK, BLOCK):
        part = slice(begin, begin + BLOCK)
        stamps = 20_000_000 * np.arange(begin, begin + BLOCK)
        detector.add(begin, stamps, Rows(coefficients[part], targets[part]))
        detector.test()
        for gap in detector.gaps:
            if gap.since is not None:
                opened.setdefault(gap.channel, begin // BLOCK)
    sizes = [gap.times_floor for gap in detector.gaps]
    return {
        "alarms": str(sorted(opened)),
        "first": float(min(opened.values(), default=-1)),
        "size": float(np.max(sizes, initial=0.0)),
        "known": float(detector.unchanged_before(range(len(first.model.channels)))),
    }


def _said(session: Session, samples: Samples) -> Figures:
    session.review.check.add(samples)
    session.review.judge()
    findings = [(f.cause.kind, sorted(f.cause.places), f.sure) for f in session.review.findings]
    return {"findings": str(sorted(findings, key=str)), "remarks": str(len(session.review.check.remarks))}


def _judged() -> Iterator[Case]:
    """Sound recordings, whole and their halves."""
    for name in SETS:
        robot = Robot(CASES[name], candidates=False)
        recordings, configuration = robot.read()
        for bag, whole in recordings.items():
            first, second = split_held_out(whole, 0.5)
            for part, samples in (("", whole), (" 1st half", first), (" 2nd half", second)):

                def run(robot: Robot = robot, given: Configuration = configuration, own: Samples = samples) -> Figures:
                    return _said(robot.session(given), own)

                yield Case("sound", f"{name} {bag}{part}", run)


def _judged_faults() -> Iterator[Case]:
    """Faults of whole recordings."""
    for name in _PLANTED:
        recording = Recording.read(SOURCES[name])
        for fault in FAULTS:
            if fault.kind not in ("", "stream") and not fault.refused and fault.fits(recording):
                planted = _planted(recording, fault, fault.sizes[0])
                samples = _samples(planted.session(), planted.bag)

                def run(planted: _Planted = planted, samples: Samples = samples) -> Figures:
                    return _said(planted.session(), samples)

                yield Case("doubts", f"{name} {fault.name}", run)


def _gaps() -> Iterator[Case]:
    """The gap workflow on clean and realistic robots from their URDFs, and on a measured arm."""
    measured = DATA / CASES["tx40"].train[0], (DATA / CASES["tx40"].urdf).read_text(encoding="utf-8")
    every = [*_recorded(), ("tx40", measured[1], measured[0])]
    for name, urdf, path in every:
        session = gap_session(urdf, Configuration(), name)
        bag = Kept(path)
        stamps = [message.time for batch in bag.batches(list(bag.topics)) for message in batch][:100]
        cutoff = gap_cutoff(session, message_rate(stamps))
        samples = Samples.concatenate(list(read_samples(bag, session, gap_pipeline(session, cutoff), _TOPICS)))
        train, test = split_held_out(samples, HELD_OUT)
        recordings = GapSamples(cutoff=cutoff, train=[train], held_out=[test])

        def run(urdf: str = urdf, recordings: GapSamples = recordings) -> Figures:
            session = gap_session(urdf, Configuration(), "a robot")
            identified = identified_in(session, recordings)
            result = find_gap_in_samples(session, recordings, None, identified, lambda *_: None)
            named = sorted((f.effect, f.joint or f.link or "", f.confidence) for f in result.findings)
            return {"gap": float(np.nansum(result.gap.after)), "verdict": str(result.verdict), "named": str(named)}

        yield Case("gap", name, run)
