"""A payload attached in mid-stream: how long until its mass is known, by forgetting time.

An arm stands still, takes a payload and moves on. The payload's mass is what the mass of the last body has changed by
since the last estimate without it.
"""

from __future__ import annotations

import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.report import Report
from geomid_ros.estimation.estimator import WarmStart
from geomid_ros.files.bags.bag import Bag
from geomid_ros.live.solver import CHOSEN_ANEW
from geomid_ros.model.samples import Samples
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Topics, read_samples
from geomid_ros.session.session import Session, save
from geomid_ros.simulation.description import robot_description
from geomid_ros.simulation.options import Hidden, SimulationOptions
from geomid_ros.simulation.recording import simulate
from geomid_ros.simulation.robot import build_robot

_ROBOT, _SENSOR_LINK, _LAST_LINK = "arm7", "wrist_ft", "tool"
_MASS = 1.0  # kg
_BEFORE, _AFTER = 30.0, 30.0  # s
_EVERY = 0.5  # s between solves
_FORGETTING_TIMES = (0.0, 15.0, 5.0, 2.0)  # s; 0: never
_CLOSE = 0.1
_WRENCH = {"wrenches": ["wrist"], "wrench.wrist.topic": "/wrench", "wrench.wrist.frame": _SENSOR_LINK}
_TOPICS = Topics("joint_states", "odom")


@dataclass(frozen=True)
class _Course:
    """The payload's estimated ``masses`` [kg] at ``times`` [s] after it was attached."""

    forgetting_time: float
    times: list[float]
    masses: list[float]

    @property
    def settled(self) -> float:
        """From when on the mass stays within a tenth of the truth [s]; infinite if it does not."""
        far = np.flatnonzero(np.abs(np.array(self.masses) / _MASS - 1.0) > _CLOSE)
        following = int(far[-1]) + 1 if len(far) else 0
        return self.times[following] if following < len(self.times) else np.inf


def run(report: Report) -> None:
    """The table of times and the picture of the masses."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        report.progress("payload: simulating")
        bags = _record(folder, "before", _BEFORE, 1, ()), _record(folder, "after", _AFTER, 2, (_payload(),))
        courses = {}
        for setup, configuration, urdf in _setups(folder, bags[0]):
            report.progress(f"payload: {setup}")
            recorded = [_samples(bag, Session(urdf, configuration, _ROBOT)) for bag in bags]
            courses[setup] = [
                _follow(Session(urdf, configuration.with_values({"forgetting_time": time}), _ROBOT), *recorded)
                for time in _FORGETTING_TIMES
            ]
    headings = ["", *(_label(time) for time in _FORGETTING_TIMES)]
    rows = [
        [setup, *(f"{c.settled:.1f} s" if np.isfinite(c.settled) else "not in time" for c in own)]
        for setup, own in courses.items()
    ]
    caption = (
        f"Seconds after a payload of {_MASS:g} kg was attached from which on its mass stays within 10 % of the truth; "
        "the filter's lag, and the 2 s in which the arm sets itself in motion, included. A solve every "
        f"{_EVERY:g} s, warm as in the node. Last link alone: the URDF and estimate.json of the arm without payload."
    )
    report.table("A changing payload: seconds to its mass, by forgetting time", headings, rows, caption)
    report.picture("payload", _draw(courses))
    told = {setup: [asdict(c) | {"settled": c.settled} for c in own] for setup, own in courses.items()}
    report.result("payload", told)


def _record(folder: Path, name: str, duration: float, motion: int, payload: tuple[Hidden, ...]) -> Path:
    """A recording of the one robot, with the friction and offsets that any of them has."""
    options: dict[str, Any] = {"robot": _ROBOT, "wrench_frame": _SENSOR_LINK}
    everyday = [Hidden(e.name, e.joint, None, e.parameters) for e in build_robot(SimulationOptions(**options)).effects]
    hide = (*everyday, *payload)
    simulate(folder / name, SimulationOptions(**options, motion_seed=motion, duration=duration, hide=hide))
    return folder / name


def _payload() -> Hidden:
    return Hidden("payload", _LAST_LINK, None, {"mass": _MASS, "com_x": 0.02, "com_y": -0.03, "com_z": 0.1})


def _setups(folder: Path, bag: Path) -> list[tuple[str, Configuration, str]]:
    """Name, configuration and robot description."""
    urdf = robot_description(_ROBOT)
    session = Session(urdf, Configuration(), _ROBOT)
    session.identifier.add(_samples(bag, session))
    before = session.identifier.solve()
    save(session, folder, before)
    last = Configuration({"links": [before.links[-1].name], "model": str(folder / "estimate.json")})
    return [
        ("all links, joint efforts", Configuration(), urdf),
        ("all links, joint efforts and wrist sensor", Configuration(_WRENCH), urdf),
        ("last link alone, joint efforts", last, (folder / "identified.urdf").read_text(encoding="utf-8")),
    ]


def _samples(path: Path, session: Session) -> Samples:
    """The samples of a recording, stamped with the time since its beginning at which they are ready."""
    pipeline = session.new_pipeline()
    with Bag(path) as bag:
        samples = Samples.concatenate(list(read_samples(bag, session, pipeline, _TOPICS)))
        return replace(samples, stamps=samples.stamps - bag.start + round(1e9 * pipeline.lag))


def _follow(session: Session, before: Samples, after: Samples) -> _Course:
    """Solve again and again while the second recording comes in, each time from where the last solve ended."""
    identifier = session.identifier
    identifier.add(before)
    estimate, chosen = identifier.solve(), identifier.rows
    without, times, masses = estimate.links[-1].mass, [], []
    every = round(_EVERY / (1e-9 * float(after.stamps[1] - after.stamps[0])))
    for begin in range(0, len(after) - every, every):
        identifier.add(after.select(slice(begin, begin + every)))
        warm = WarmStart(estimate.parameters)
        if identifier.has_grown_beyond(chosen, CHOSEN_ANEW):
            warm, chosen = None, identifier.rows
        estimate = identifier.solve(warm)
        times.append(1e-9 * float(after.stamps[begin + every - 1]))
        masses.append(estimate.links[-1].mass - without)
    return _Course(session.configuration["forgetting_time"], times, masses)


def _label(forgetting_time: float) -> str:
    return f"{forgetting_time:g} s" if forgetting_time else "never"


def _draw(courses: dict[str, list[_Course]]) -> Figure:
    figure = Figure(figsize=(4.5 * len(courses), 3.6), layout="constrained")
    panels = figure.subplots(1, len(courses), sharey=True)
    for panel, (setup, own) in zip(panels, courses.items(), strict=True):
        _panel(panel, own)
        panel.set_title(setup, fontsize=10)
        panel.set_xlabel("time since the payload was attached [s]")
    panels[0].set_ylabel("payload's mass [kg]")
    panels[0].legend(title="forgetting time", fontsize=8)
    return figure


def _panel(panel: Axes, courses: list[_Course]) -> None:
    panel.axhline(_MASS, color="black", linewidth=1.0)
    panel.axhspan((1.0 - _CLOSE) * _MASS, (1.0 + _CLOSE) * _MASS, color="black", alpha=0.08)
    for course, colour in zip(courses, colormaps["viridis"](np.linspace(0.9, 0.0, len(courses))), strict=True):
        panel.plot(course.times, course.masses, color=colour, label=_label(course.forgetting_time))
    panel.set_ylim(-0.25 * _MASS, 1.6 * _MASS)
    panel.grid(alpha=0.3)


if __name__ == "__main__":
    run(Report())
