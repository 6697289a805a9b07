"""Plant faults in sound recordings, and count what is named right, wrong, or not at all.

    python -m benchmarks.corruption [RECORDING ...] [--fault TEXT] [--clean [--parts SECONDS]]
        [--out corruption.json]

With --clean nothing is planted: every sound recording, measured and simulated, is judged whole, each of its halves by
itself, and with a rest of 2 s in front; whatever is doubted is a false doubt. With --parts each is judged in parts of
so many seconds instead: a short recording shows little of its own units, signs and zeros.

Every fault is written into a bag, which is read as ``geomid identify`` reads it. Reads measured recordings in
../shared/data, which are not part of this repository; without them only the simulated arms are tried.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

import geomid_ros
from benchmarks.corruption.faults import FAULTS, Fault
from benchmarks.corruption.recording import CLEAN, SOURCES, Recording
from benchmarks.corruption.simulated import RAIL, ROBOTS, rested, simulated
from geomid_ros.api.identify import Identification
from geomid_ros.errors import GeomidError
from geomid_ros.model.channels import WrenchSensor
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Bags, read_bags
from geomid_ros.session.session import Session

REST = 2.0
"""Seconds that a robot stands in front of a sound recording."""
SEEDS = 14
"""Simulated recordings of each robot."""
NAMED, SUSPECTED, WRONG, SILENT = "named", "suspected", "wrong", "silent"


def answer(planted: Recording, fault: Fault, size: Any) -> tuple[str, str]:
    """What is said of a recording in which a fault of a size is planted: how right that is, and the sentences."""
    with tempfile.TemporaryDirectory(prefix="corruption-") as folder:
        try:
            return _answer(planted, fault, size, planted.write(Path(folder) / "bag"))
        except GeomidError as error:
            return NAMED if fault.refused and fault.refused in str(error) else WRONG, str(error)


def _answer(planted: Recording, fault: Fault, size: Any, bag: Path) -> tuple[str, str]:
    if fault.doubted:
        reasons = identified(planted, bag).verdict.reasons
        return (NAMED if reasons else SILENT), "; ".join(reasons)
    session = judged(planted, bag)
    said = "; ".join(finding.sentence for finding in session.review.findings)
    if not fault.kind:
        accounts = session.pipeline.ledger.topics.values()
        noted = [reason for account in accounts for reason in (*account.rejected, *account.noted)]
        return (NAMED if any(fault.noted in reason for reason in noted) else SILENT), "; ".join(noted)
    names = planted.robot.joint_names
    places = None if fault.joints is None else {names[place] for place in fault.joints(size)}
    if fault.kind == "constant" and session.review.check.unmeasured:
        return NAMED, f"not measured: {', '.join(session.review.check.unmeasured)}"
    if not session.review.findings:  # the result may be doubted
        reasons = identified(planted, bag).verdict.reasons
        return (SUSPECTED if reasons else SILENT), "; ".join(reasons)
    for finding in session.review.findings:
        for cause in (finding.cause, *finding.rivals):
            right = cause.kind == fault.kind or (fault.said and fault.said in cause.sentence)
            if right and (places is None or set(cause.places) == places):
                return (NAMED if finding.sure else SUSPECTED), said
    # That a joint is not explained names no cause.
    named = [finding for finding in session.review.findings if finding.sure and finding.cause.kind != "unexplained"]
    return (WRONG if named else SUSPECTED), said


def judged(recording: Recording, bag: Path) -> Session:
    """A session that has read and judged a bag."""
    source = recording.source
    configuration = Configuration(dict(source.settings))
    if source.wrench:
        configuration = configuration.with_sensors([WrenchSensor.parse(source.wrench)])
    session = Session(recording.urdf, configuration, str(source.urdf))
    read_bags(session, Bags(fitted=[bag], hold_out=0.0, unloaded=True), lambda _: None)
    return session


def identified(recording: Recording, bag: Path) -> Identification:
    """What is identified from a bag."""
    source = recording.source
    return geomid_ros.identify(bag, recording.urdf, config=dict(source.settings), wrench=source.wrench or ())


def recording_of(name: str) -> Recording:
    """A measured recording by its name, or a simulated one by ROBOT-SEED."""
    if name in CLEAN:
        return Recording.read(CLEAN[name])
    robot, _, seed = name.rpartition("-")
    return simulated(robot, int(seed))


def cases(names: list[str], text: str) -> Iterator[tuple[str, Recording, Fault]]:
    """Every recording with every fault that can be planted in it."""
    for name in names:
        recording = recording_of(name)
        for fault in FAULTS:
            if text in fault.name and fault.fits(recording):
                yield name, recording, fault


def sound(name: str, seconds: float | None) -> Iterator[tuple[str, Recording]]:
    """A recording in which nothing is wrong: whole, its halves, and with a rest in front; or in parts of so many
    seconds."""
    whole = recording_of(name)
    if seconds is not None:
        count = int((whole.stamps[-1] - whole.stamps[0]) / seconds)
        yield from ((f"part {k + 1}", whole.part(k / count, (k + 1) / count)) for k in range(count))
        return
    yield "whole", whole
    yield "first half", whole.part(0.0, 0.5)
    yield "second half", whole.part(0.5, 1.0)
    yield "rest in front", rested(whole, REST)


def doubts(names: list[str], seconds: float | None) -> list[dict[str, Any]]:
    """Judge sound recordings; returns what is said of each."""
    kept = []
    for name in names:
        for part, recording in sound(name, seconds):
            with tempfile.TemporaryDirectory(prefix="corruption-") as folder:
                session = judged(recording, recording.write(Path(folder) / "bag"))
            said = "; ".join(finding.sentence for finding in session.review.findings)
            kept.append({"recording": name, "part": part, "said": said, "remarks": list(session.review.remarks)})
            if said or session.review.remarks:
                print(
                    f"{'doubted' if said else 'remarked'}: {name}, {part}: {said or session.review.remarks}", flush=True
                )
    print(f"{sum(bool(each['said']) for each in kept)} of {len(kept)} sound recordings are doubted")
    return kept


def main() -> None:
    """Try all, print what was named by fault and in all."""
    arguments = _parsed()
    there = [name for name, source in (CLEAN if arguments.clean else SOURCES).items() if source.bag.is_dir()]
    drawn = [f"{robot}-{seed}" for robot in ROBOTS for seed in range(SEEDS)] if arguments.clean else [f"{RAIL}-0"]
    names = arguments.recordings or [*there, *drawn]
    begin = time.perf_counter()
    kept = doubts(names, arguments.parts) if arguments.clean else planted(names, arguments.fault)
    print(f"{len(kept)} recordings in {time.perf_counter() - begin:.0f} s")
    if arguments.out:
        arguments.out.write_text(json.dumps(kept, indent=2))


def planted(names: list[str], text: str) -> list[dict[str, Any]]:
    """Plant all faults, and print what was named; returns every answer."""
    counts: dict[str, Counter[str]] = {}
    kept = []
    for name, recording, fault in cases(names, text):
        for size in fault.sizes:
            faulty = fault.plant(recording, size)
            if faulty is recording:  # all axes of this URDF are alike, for example
                continue
            how, said = answer(faulty, fault, size)
            counts.setdefault(f"{fault.row} {fault.name}", Counter())[how] += 1
            kept.append({"recording": name, "fault": fault.name, "size": size, "answer": how, "said": said})
            if how != NAMED:
                print(f"{how}: {name}, {fault.name}, {size}: {said[:160]}", flush=True)
    _print(counts)
    return kept


def _parsed() -> argparse.Namespace:
    names = f"of {', '.join(CLEAN)}, or ROBOT-SEED of {', '.join(ROBOTS)}"
    parser = argparse.ArgumentParser(prog="python -m benchmarks.corruption", description=__doc__)
    parser.add_argument("recordings", nargs="*", metavar="RECORDING", help=names)
    parser.add_argument("--fault", default="", help="only those with this in their names")
    parser.add_argument("--clean", action="store_true", help="judge sound recordings")
    parser.add_argument("--parts", type=float, metavar="SECONDS", help="with --clean: judge parts of them")
    parser.add_argument("--out", type=Path, help="file for every answer (JSON)")
    return parser.parse_args()


def _print(counts: dict[str, Counter[str]]) -> None:
    table = Table(title="What was named", box=box.SIMPLE_HEAD, title_justify="left")
    for heading in ("fault", NAMED, SUSPECTED, WRONG, SILENT):
        table.add_column(heading, justify="left" if heading == "fault" else "right")
    total: Counter[str] = sum(counts.values(), Counter())
    for fault, own in (*counts.items(), ("all", total)):
        table.add_row(fault, *(str(own[how]) for how in (NAMED, SUSPECTED, WRONG, SILENT)))
    Console(width=100).print(table)
    for how in (NAMED, SUSPECTED, WRONG, SILENT):
        print(f"{how}: {100.0 * total[how] / max(total.total(), 1):.1f} %")


if __name__ == "__main__":
    main()
