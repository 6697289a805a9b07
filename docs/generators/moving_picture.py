"""Draws the moving picture of README.md: what is known of an arm while its recording goes by.

The program identifies the arm of ``bags/arm7`` from the first second of its recording, then from a little more, and so
on. Every frame shows what it found by then, beside the URDF it began with and the truth that the simulator had. The
fit is judged on the last 30 % of the recording, which are never fitted.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from PIL import Image

from geomid_ros.estimation.estimate import Estimate
from geomid_ros.model.samples import Samples
from geomid_ros.report.pictures import Ellipsoid
from geomid_ros.session.configuration import Configuration
from geomid_ros.session.recordings import Bags, read_bags
from geomid_ros.session.session import Session
from geomid_ros.types import FloatArray

ROOT = Path(__file__).parents[2]
BAG, URDF, TRUTH = (ROOT / "bags" / name for name in ("arm7", "arm7.urdf", "arm7.truth.json"))
PICTURE = ROOT / "docs/pages/figures/arm7.gif"
WRENCH = {
    "wrenches": ["wrist"],
    "wrench.wrist.topic": "/wrench",
    "wrench.wrist.frame": "wrist_ft",
    "wrench.wrist.role": "mounted",
}
FRAMES, MILLISECONDS, PAUSE = 44, 120, 3000
FIRST = 0.3  # [s] of motion before the first estimate
INK, FAINT, GREY, ORANGE = "#202124", "#5f6368", "#9aa0a6", "#c8641e"
SHARES = LinearSegmentedColormap.from_list("share", ["#dcdcd8", "#9ad3c4", "#41b0c4", "#1d70b2", "#1f2a80"])


@dataclass(frozen=True, eq=False)
class Moment:
    """What was known after so many seconds: the estimate, RMS by channel on held-out data, the arm's pose."""

    seconds: float
    estimate: Estimate
    rms: FloatArray
    pose: Samples


def moments(session: Session, train: Samples, held_out: list[Samples]) -> Iterator[Moment]:
    """Identify from more and more of the recording."""
    times = train.seconds - train.seconds[0]
    begin = 0.0
    for end in np.linspace(FIRST, times[-1], FRAMES):
        new = (times >= begin) & (times < end) if end < times[-1] else times >= begin
        session.identifier.add(train.select(new))
        estimate = session.identifier.solve()
        last = int(np.flatnonzero(new)[-1])
        rms = session.rms(held_out, estimate.parameters)
        yield Moment(float(end), estimate, rms, train.select(slice(last, last + 1)))
        begin = end


# Rows: to the right and up, from 16 degrees above, across the arm.
AZIMUTH, ELEVATION = np.radians(-60.0), np.radians(16.0)
VIEW = np.array(
    [
        [-np.sin(AZIMUTH), np.cos(AZIMUTH), 0.0],
        [-np.sin(ELEVATION) * np.cos(AZIMUTH), -np.sin(ELEVATION) * np.sin(AZIMUTH), np.cos(ELEVATION)],
    ]
)


def draw_arm(axes: Axes, session: Session, moment: Moment) -> None:
    """The arm's bodies: outlines as in the URDF, filled as identified."""
    frames = session.robot.link_frames(moment.pose)
    nominal = session.model.nominal_inertias.reshape(-1, 10)
    for link, before in zip(moment.estimate.links, nominal, strict=True):
        colour = SHARES(link.from_data)
        found, urdf = (Ellipsoid.of(p, *frames[link.name]).outline(VIEW) for p in (link.parameters, before))
        axes.add_patch(Polygon(found.T, fc=colour, ec=[0.6 * c for c in colour[:3]], lw=0.8, alpha=0.85))
        axes.plot(*urdf, color=GREY, lw=0.9)
    names = [link.name for link in moment.estimate.links]
    chain = np.array([np.zeros(3), *(frames[name][1] for name in names)]) @ VIEW.T
    axes.plot(*chain.T, "-o", color="#3c4043", lw=2.0, ms=3.5, mfc="white", mew=1.0)
    axes.set(xlim=(-0.42, 0.72), ylim=(-0.06, 1.39), aspect="equal")
    axes.set_axis_off()


def draw_masses(axes: Axes, moment: Moment, urdf: FloatArray, truth: FloatArray) -> None:
    """Each mass relative to the true one, with its 95 % interval."""
    for row, link in enumerate(moment.estimate.links):
        value, spread = link.mass / truth[row], np.exp(1.96 * link.std_mass / link.mass)
        axes.plot([value / spread, value * spread], [row, row], color=ORANGE, lw=5.0, alpha=0.35, solid_capstyle="butt")
        axes.plot(urdf[row] / truth[row], row, "o", ms=5.0, mfc="white", mec=GREY, mew=1.2)
        axes.plot(value, row, "o", ms=5.5, color=ORANGE, mec="white", mew=0.6)
    axes.axvline(1.0, color=INK, lw=1.0, zorder=0.5)
    axes.set(xlim=(0.6, 1.4), ylim=(len(truth) - 0.4, -0.6), xticks=[0.6, 0.8, 1.0, 1.2, 1.4])
    axes.set_xticklabels(["-40 %", "-20 %", "truth", "+20 %", "+40 %"])
    axes.set_yticks(range(len(truth)), [link.name for link in moment.estimate.links])
    heading(axes, "mass of each link, 95 % interval")


def draw_fit(axes: Axes, moment: Moment, nominal: FloatArray, joints: int) -> None:
    """RMS of what is left of each joint's effort on data that are never fitted."""
    places = np.arange(joints)
    axes.bar(places - 0.19, nominal[:joints], 0.34, color="#c4c7ca")
    axes.bar(places + 0.19, moment.rms[:joints], 0.34, color=ORANGE)
    axes.set(yscale="log", ylim=(3e-3, 12.0), yticks=[0.01, 0.1, 1.0, 10.0])
    axes.set_yticklabels(["0.01", "0.1", "1", "10"])
    axes.minorticks_off()
    axes.set_xticks(places, [f"{joint + 1}" for joint in places])
    heading(axes, "joint by joint: error on data never fitted [N m]")


def heading(axes: Axes, text: str) -> None:
    """A heading over axes without a frame."""
    axes.set_title(text, fontsize=9.5, color=INK, loc="left", pad=6)
    axes.tick_params(labelsize=8.5, length=0, colors=FAINT)
    for side in axes.spines.values():
        side.set_visible(False)
    axes.grid(axis="both", color="#e8eaed", lw=0.7)
    axes.set_axisbelow(True)


def draw_key(axes: Axes) -> None:
    """What the marks mean."""
    axes.set_axis_off()
    axes.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0))
    for x, face, edge, text in (
        (0.02, "white", GREY, "URDF"),
        (0.18, ORANGE, ORANGE, "identified"),
        (0.44, SHARES(0.0), GREY, "from the URDF"),
        (0.73, SHARES(0.9), SHARES(1.0), "from the data"),
    ):
        axes.plot(x, 0.5, "o", ms=6, mfc=face, mec=edge)
        axes.text(x + 0.03, 0.48, text, fontsize=8.5, color=FAINT, va="center")


def frame(session: Session, moment: Moment, nominal_rms: FloatArray, truth: FloatArray) -> Image.Image:
    """One picture."""
    figure = Figure(figsize=(8.0, 4.4), dpi=100, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    draw_arm(figure.add_axes((0.0, 0.01, 0.38, 0.88)), session, moment)
    urdf = session.model.nominal_inertias.reshape(-1, 10)[:, 0]
    draw_masses(figure.add_axes((0.48, 0.47, 0.48, 0.35)), moment, urdf, truth)
    draw_fit(figure.add_axes((0.48, 0.065, 0.48, 0.26)), moment, nominal_rms, len(session.robot.joints))
    draw_key(figure.add_axes((0.4, 0.92, 0.59, 0.06)))
    figure.text(0.02, 0.93, f"after {moment.seconds:.1f} s of motion", fontsize=14, weight="bold", color=INK)
    canvas.draw()
    return Image.frombytes("RGBA", canvas.get_width_height(), bytes(canvas.buffer_rgba())).convert("RGB")


def true_masses(session: Session) -> FloatArray:
    """Of each body, with all that is fixed to it, as the simulator had it [kg]."""
    masses = {link["name"]: link["mass"] for link in json.loads(TRUTH.read_text(encoding="utf-8"))["links"]}
    return np.array([sum(masses.get(name, 0.0) for name in (body.name, *body.merged)) for body in session.robot.bodies])


def one_below_another(pictures: list[Image.Image]) -> Image.Image:
    """All in one, for the colours that they share."""
    width, height = pictures[0].size
    sheet = Image.new("RGB", (width, height * len(pictures)))
    for number, picture in enumerate(pictures):
        sheet.paste(picture, (0, number * height))
    return sheet


def main() -> None:
    """Identify, draw, write the GIF."""
    session = Session(URDF.read_text(encoding="utf-8"), Configuration(WRENCH, "the moving picture"), str(URDF))
    train = list[Samples]()
    held_out = read_bags(session, Bags(fitted=[BAG]), train.append)
    fitted = Samples.concatenate(train)
    found = list(moments(session, fitted, held_out))
    nominal_rms = session.rms(held_out, session.model.nominal_parameters)
    truth = true_masses(session)
    pictures = [frame(session, moment, nominal_rms, truth) for moment in found]
    palette = one_below_another(pictures[::4]).quantize(192, dither=Image.Dither.NONE)
    first, *others = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    durations = [MILLISECONDS] * (len(pictures) - 1) + [PAUSE]
    first.save(PICTURE, save_all=True, append_images=others, duration=durations, loop=0, optimize=True)
    print(f"{PICTURE.relative_to(ROOT)}: {len(pictures)} frames, {PICTURE.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
