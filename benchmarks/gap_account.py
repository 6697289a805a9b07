"""Whether ``geomid gap`` tells all that it writes: values without a finding, and its table against ``geomid verify``.

    python -m benchmarks.gap_account [--seeds 100:106] [--sets lwr4 ...] [--out out/realistic]

An empty ``--seeds ""`` leaves the simulated robots out.

Every seed is a robot of the realistic bench (:mod:`benchmarks.blind.realistic`), compared with the model identified
before the change and judged on a third recording. The sets are measured robots in ../shared/data. A value counts as
written where it differs from the model that ``gap`` was given by more than its standard deviation there; it is told
where a finding, or a rival of one, says so. Beside the URDF alone there is nothing to count but unsure findings.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

import geomid_ros
from benchmarks.blind.case import robot_file
from benchmarks.blind.realistic.case import RealisticCase, draw
from benchmarks.blind.realistic.judging import Size, _sizes
from benchmarks.blind.realistic.running import _recorded
from benchmarks.measured_data import DATA
from geomid_ros.errors import GeomidError
from geomid_ros.files.models.loaded_model import LoadedModel
from geomid_ros.model.effects import Effect, effect_class
from geomid_ros.session.session import save
from geomid_ros.session.written_simulation import write_found
from geomid_ros.simulation.recording import simulate

_WITHIN = 0.05  # of what verify says


@dataclass(frozen=True)
class Run:
    """Bags for ``gap``, a bag to judge on, the URDF, and a bag that a model is identified from first, or none."""

    name: str
    bags: tuple[Path, ...]
    validate: Path
    urdf: Path
    known: Path | None = None
    truth: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Account:
    """What is wrong with one run: values written without a finding, findings written that are not sure, and by how much
    the table differs from ``verify`` by channel, relative; ``floors``: whether verify knows one for every channel."""

    name: str
    verdict: str
    sure: tuple[str, ...]
    untold: tuple[str, ...]
    unsure: tuple[str, ...]
    off: Mapping[str, float]
    floors: bool
    table: float
    again: float
    sizes: tuple[Size, ...]

    @property
    def worst(self) -> float:
        """The largest difference of a channel."""
        return max(map(abs, self.off.values()), default=math.nan)


def _sets() -> dict[str, Run]:
    lwr, airbot, kr300 = (DATA / name for name in ("kuka_lwr4_hw", "airbot_play", "kuka_kr300"))
    return {
        "lwr4": Run("lwr4", (lwr / "measurements_1",), lwr / "measurements_2", lwr / "kuka_lwr4.urdf"),
        "airbot": Run("airbot", (airbot / "chirp",), airbot / "trapez", airbot / "airbot_play.urdf"),
        "airbot model": Run(
            "airbot model",
            (airbot / "chirp_loaded",),
            airbot / "trapez",
            airbot / "airbot_play.urdf",
            airbot / "chirp",
        ),
        "kr300 model": Run("kr300 model", (kr300 / "FF_B",), kr300 / "FF_C", kr300 / "kr300.urdf", kr300 / "FF_A"),
    }


def _realistic(seed: int, out: Path) -> Run:
    """The recordings of a seed, with a third one after the change."""
    folder = out / "bags" / str(seed)
    drawn = draw(seed)
    document = _recorded(drawn, folder)
    later = folder / "later"
    if not later.exists():
        change = replace(drawn.change, parameters=document["case"]["change"]["parameters"])
        was = replace(drawn.was, motion_speed=document["case"]["was"]["motion_speed"])
        case = RealisticCase(seed, was, change, drawn.target)
        options = replace(case.now, robot=robot_file(case.was.robot), motion_seed=300_000 + seed)
        simulate(later, options)
    return Run(str(seed), (folder / "now",), later, folder / "robot.urdf", folder / "was", document["truth"])


def account(run: Run, folder: Path) -> Account:
    """Run ``gap``, and ``verify`` on what it wrote."""
    model = None
    if run.known is not None:
        known = geomid_ros.identify(run.known, run.urdf)
        save(known.session, folder / "known", known.estimate)
        model = folder / "known" / "estimate.json"
    found = geomid_ros.find_gap(run.bags, run.urdf, model=model, validate=run.validate)
    write_found(folder / "gap", found.session, found.result, identified=found.identified)
    (folder / "gap.json").write_text(json.dumps(found.document, indent=1))
    written = folder / "gap" / "estimate.json"
    checked = geomid_ros.verify(written, run.validate, run.urdf)
    document = found.document
    said = {name: _product(document, name) for name in document["floor"]}
    off = {name: said[name] / each["value"] - 1.0 for name, each in checked.rms.items() if said[name] == said[name]}
    _rms(folder, said, {name: each["value"] for name, each in checked.rms.items()})
    return Account(
        name=run.name,
        verdict=document["verdict"],
        sure=tuple(f"{f.effect} {f.joint or f.link}" for f in found.findings if f.confidence == "confident"),
        untold=tuple(_untold(model, written, document)) if model else (),
        unsure=tuple(_unsure(model, written, document)),
        off=off,
        floors=all(math.isfinite(checked.rms[name]["floor"]) for name in off),
        table=float(np.nanmean([said[name] for name in off])),
        again=float(np.nanmean([checked.rms[name]["value"] for name in off])),
        sizes=tuple(_sure_sizes(document, run.truth)),
    )


def _sure_sizes(document: Mapping[str, Any], truth: Mapping[str, Any] | None) -> Iterator[Size]:
    """How far the sizes of sure findings are off."""
    for finding in document["findings"]:
        if truth and finding["confidence"] == "confident":
            yield from _sizes(finding, truth)


def _rms(folder: Path, said: Mapping[str, float], checked: Mapping[str, float]) -> None:
    (folder / "rms.json").write_text(json.dumps({"table": said, "verify": checked}, indent=1))


def _product(document: Mapping[str, Any], channel: str) -> float:
    """The RMS of a channel by the table [N m, N]."""
    times, floor = document["gap"]["after"][channel], document["floor"][channel]
    return math.nan if times is None or floor is None else float(times * floor)


def _values(path: Path) -> dict[tuple[str, str, str], tuple[float, float]]:
    """Coefficients of all effects but payloads in an ``estimate.json``, with their standard deviations, by effect,
    place and parameter: one value may be said by several effects together."""
    found: dict[tuple[str, str, str], tuple[float, float]] = {}
    for known in LoadedModel.read(str(path)).effects:
        for part, own in () if known.is_payload else known.cls.coefficients(known.values).items():
            for form, value in zip(part.column_parameters, own, strict=True):
                key = part.name, known.joint, form.name
                quantity, before = known.parameters.get(form.name), found.get(key, (0.0, 0.0))
                std = math.nan if quantity is None else quantity.std
                found[key] = before[0] + value, math.hypot(before[1], std)
    return found


def _untold(model: Path, written: Path, document: Mapping[str, Any]) -> Iterator[str]:
    """Values that differ from those given by more than their standard deviation, of which no finding says so."""
    told = set(_told(document))
    before, after = _values(model), _values(written)
    for key in sorted({*before, *after}):
        effect, joint, name = key
        value, std = before.get(key, (0.0, math.nan))
        now = after.get(key, (0.0, math.nan))[0]
        deviation = std if math.isfinite(std) else 1e-9 * abs(value)
        if abs(now - value) > deviation and (effect, joint) not in told:
            yield f"{effect} {joint} {name} {value:.4g} +- {std:.2g} -> {now:.4g}"
    yield from _untold_links(model, written, {link["link"] for link in document["links"]})


def _untold_links(model: Path, written: Path, told: set[str]) -> Iterator[str]:
    documents = (json.loads(path.read_text()) for path in (model, written))
    before, after = ({link["name"]: link for link in document["links"]} for document in documents)
    for name, was in before.items():
        now = after[name]
        for key in ("mass", "com", "inertia"):
            change = np.abs(np.array(now[key]) - np.array(was[key]))
            if name not in told and np.any(change > np.array(was["std"][key])):
                yield f"{key} of {name}"


def _told(document: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """What findings and their rivals say: effects, and those that they consist of, with their joints."""
    for finding in document["findings"]:
        for entry in (finding, *finding["rivals"]):
            cls: type[Effect] = effect_class(entry["effect"])
            for name in {cls.name, cls.contains, *(part.name for part in cls().parts)}:
                yield name, entry["joint"]


def _unsure(model: Path | None, written: Path, document: Mapping[str, Any]) -> Iterator[str]:
    """Findings that are not sure and in the files nevertheless."""
    before, after = _values(model) if model else {}, _values(written)
    bodies = {known.link for known in LoadedModel.read(str(written)).effects if known.is_payload}
    ordinary = {(entry["effect"], entry["joint"]) for entry in document.get("ordinary", ())}
    for finding in document["findings"]:
        if finding["confidence"] == "confident":
            continue
        place = finding["effect"], finding["joint"]
        own = [(after[key][0], before.get(key, (0.0, 0.0))[0]) for key in after if key[:2] == place not in ordinary]
        changed = any(abs(value - was) > 1e-3 * abs(was) for value, was in own)
        if changed or (finding["link"] and finding["link"] in bodies):
            yield f"{finding['effect']} {finding['joint'] or finding['link']} {finding['confidence']}"


def main() -> None:
    """A line for each run, and the sums."""
    arguments = _parsed()
    found = []
    for make in _runs(arguments):
        try:
            name, run = make
            one = account(run() if callable(run) else run, arguments.out / "account" / name.replace(" ", "_"))
        except (GeomidError, np.linalg.LinAlgError) as error:
            print(f"{make[0]}: {error}")
            continue
        found.append(one)
        _print(one)
    _print_sums(found)


def _runs(arguments: argparse.Namespace) -> Iterator[tuple[str, Any]]:
    for seed in arguments.seeds:
        yield str(seed), lambda seed=seed: _realistic(seed, arguments.out)
    for name in arguments.sets:
        if DATA.is_dir():
            yield name, _sets()[name]
        else:
            print(f"{name}: the measured recordings are not there: {DATA}")


def _print(one: Account) -> None:
    print(f"{one.name}: {one.verdict}; sure: {', '.join(one.sure) or 'nothing'}")
    sizes = "; ".join(f"{s.effect} {s.joint} {s.off:.1%} {s.sigmas:.1f} sigma" for s in one.sizes)
    print(f"  sizes off by: {sizes or 'none known'}; left {one.again:.4g}")
    print(f"  table against verify: {', '.join(f'{name} {off:+.1%}' for name, off in one.off.items())}")
    for title, values in (("without a finding", one.untold), ("written, not sure", one.unsure)):
        if values:
            print(f"  {title}: {'; '.join(values)}")
    sys.stdout.flush()


def _print_sums(found: list[Account]) -> None:
    table = Table(title="What is written and not told", box=box.SIMPLE_HEAD, title_justify="left")
    for heading in ("", "values untold", "unsure", "table off by", "floors", "table", "verify"):
        table.add_column(heading, justify="right")
    for one in found:
        numbers = (str(len(one.untold)), str(len(one.unsure)), f"{one.worst:.1%}", "yes" if one.floors else "no")
        table.add_row(one.name, *numbers, f"{one.table:.4g}", f"{one.again:.4g}")
    Console(width=120).print(table)
    untold, unsure = (sum(map(len, each)) for each in ([o.untold for o in found], [o.unsure for o in found]))
    close = sum(one.worst <= _WITHIN for one in found)
    print(f"values untold {untold}, unsure findings written {unsure}, table within 5 % in {close} of {len(found)} runs")


def _parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.gap_account", description=__doc__)
    parser.add_argument("--seeds", type=_seeds, default=range(100, 120), help="FIRST:LAST+1 (100:120)")
    parser.add_argument("--sets", nargs="*", default=[], choices=list(_sets()), metavar="SET", help=", ".join(_sets()))
    parser.add_argument("--out", type=Path, default=Path("out/realistic"), help="folder of recordings, kept")
    return parser.parse_args()


def _seeds(text: str) -> range:
    return range(*map(int, text.split(":"))) if text else range(0)


if __name__ == "__main__":
    main()
