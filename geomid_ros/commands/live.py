"""``geomid demo``, ``play`` and ``dashboard``: commands for a running node and its topics."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

import geomid_ros
from geomid_ros.commands.options import OUT, PATH
from geomid_ros.commands.terminal import progress_bar, results_console
from geomid_ros.errors import InputError, needing_ros, printable

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from geomid_ros.files.models.estimate_file import EstimateFile
    from geomid_ros.session.session import Session


@click.command()
@click.option("--out", default=Path("geomid_out/demo"), **OUT)
@click.option(
    "--rate",
    default=1.0,
    show_default=True,
    type=click.FloatRange(0.1, 10.0),
    help="Playback speed, relative to real time.",
)
def demo(out: Path, rate: float) -> None:
    """Watch a live identification of a simulated arm.

    Plays a recording of an arm with a wrist sensor into a node, in a separate process, and shows the estimates as they
    arrive. The true inertias differ from the URDF by about 20 %; the node does not know them.
    """
    from rich.live import Live

    from geomid_ros.api.robot import configuration as configured
    from geomid_ros.files.models.estimate_file import EstimateFile
    from geomid_ros.files.models.urdf import read_urdf
    from geomid_ros.report.pictures import write_picture
    from geomid_ros.session.options import RobotOptions
    from geomid_ros.session.session import Session

    with needing_ros("the demonstration"):
        from geomid_ros.ros.player import LiveRun
    bag, urdf = shared_file("bags/arm7"), shared_file("bags/arm7.urdf")
    options = RobotOptions(wrench="/wrench:wrist_ft:mounted", config={"solve_period": max(0.1, 0.3 / rate)})
    configuration = configured(options)
    session = Session(read_urdf(urdf), configuration, str(urdf))
    truth = _true_masses(session, shared_file("bags/arm7.truth.json"))
    console = results_console()
    console.print("A node identifies a simulated arm live, from joint states and a wrench sensor at the wrist.")
    with (
        LiveRun(bag, urdf, configuration, out.resolve(), rate) as run,
        Live(console=console, refresh_per_second=8) as live,
    ):
        for masses in run.watch():
            live.update(_table(session, masses, truth, run.diagnostics.get("rows")))
    file = EstimateFile.read(out / "estimate.json")
    with progress_bar() as progress:
        offline = geomid_ros.identify(bag, urdf, config=configuration, hold_out=0.0, progress=progress)
        progress("drawing", 0.0)
        write_picture(out / "identification.png", offline.plot())
    masses = {link.name: link.mass for link in file.links}
    difference = max(abs(link.mass / float(masses[link.name]) - 1.0) for link in offline.links)
    _conclude(console, file, truth, difference, out)


def shared_file(relative: str) -> Path:
    """Find a file or folder shipped with the package, such as ``bags/arm7``."""
    prefixes = [*filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)), sys.prefix]
    folders = [Path(geomid_ros.__file__).parents[1], *(Path(prefix) / "share/geomid_ros" for prefix in prefixes)]
    for folder in folders:
        if (folder / relative).exists():
            return folder / relative
    raise InputError(f"{relative} is not installed; looked in {', '.join(map(str, folders))}")


def _true_masses(session: Session, path: Path) -> dict[str, float]:
    """True masses of the bodies [kg], each with its merged links."""
    links = {link["name"]: link["mass"] for link in json.loads(path.read_text(encoding="utf-8"))["links"]}
    bodies = zip(session.robot.body_names, session.robot.bodies, strict=True)
    return {name: sum(links.get(link, 0.0) for link in (name, *body.merged)) for name, body in bodies}


def _table(session: Session, masses: dict[str, float], truth: dict[str, float], rows: str | None) -> Table:
    from rich.table import Table

    table = Table(title="link masses [kg]", caption=f"{rows} rows" if rows else "waiting for the robot")
    for heading in ("link", "URDF", "identified", "truth"):
        table.add_column(heading, justify="left" if heading == "link" else "right", min_width=10)
    nominal = session.model.nominal_inertias.reshape(-1, 10)[:, 0]
    for name, urdf_mass in zip(session.model.body_names, nominal, strict=True):
        identified = f"{masses[name]:.3f}" if name in masses else "..."
        table.add_row(name, f"{urdf_mass:.3f}", identified, f"{truth[name]:.3f}")
    return table


def _conclude(console: Console, file: EstimateFile, truth: dict[str, float], difference: float, out: Path) -> None:
    links = file.link_estimates
    tool = max(links, key=lambda link: link.from_data)
    unidentified = [link.name for link in links if "mass" in link.cannot_tell]
    shares = [1.0 - file.rms.train[channel] / nominal for channel, nominal in file.rms.nominal.items()]
    console.print(
        f"\nIdentified from {file.rows.accepted} rows. The most certain body is {tool.name} with "
        f"{tool.mass:.4f} ± {tool.std_mass:.4f} kg (truth {truth[tool.name]:.4f}), "
        f"{100 * tool.from_data:.0f} % from data.\n"
        f"Masses not individually identifiable: {', '.join(unidentified) or 'none'}; these stay near the URDF.\n"
        f"The estimate removes {100 * sum(shares) / len(shares):.0f} % of the URDF's RMS error (mean over channels); "
        f"all bodies are physically consistent.\n"
        f"The same bag identified offline gives the same masses within {difference:.0e} (relative).\n\n"
        f"Picture: {out / 'identification.png'}\nURDF:    {out / 'identified.urdf'}\n"
        f"Numbers: {out / 'estimate.json'}, {out / 'posterior.npz'}",
        highlight=False,
        soft_wrap=True,
    )


@click.command()
@click.argument("bag", type=PATH)
@click.option(
    "--rate",
    default=1.0,
    show_default=True,
    type=click.FloatRange(0.01, 100.0),
    help="Playback speed, relative to real time.",
)
@click.option(
    "--wait", default=10.0, show_default=True, type=click.FloatRange(0.0), help="Longest wait for subscribers [s]."
)
@click.option(
    "--topic", multiple=True, help="Also publish this topic; may be repeated. A robot will follow recorded commands."
)
@click.option(
    "--config", type=PATH, help="The node's parameter file (YAML); also publish the topics of its wrench sensors."
)
def play(bag: Path, rate: float, wait: float, topic: tuple[str, ...], config: Path | None) -> None:
    """Play a rosbag on live topics.

    Publishes only the topics of BAG that geomid reads: joint_states, odom, imu and robot_description in any
    namespace, and /clock.
    """
    from geomid_ros.session.configuration import Configuration

    with needing_ros("playing a bag"):
        from geomid_ros.ros.player import play as published
    sensors = Configuration.read(config).sensors if config else []
    named = [*topic, *(sensor.topic for sensor in sensors)]
    count = 0
    with progress_bar() as progress:
        progress(f"playing {bag.name}", 0.0)
        for count, total in published(bag, rate, wait, named, lambda line: click.echo(printable(line), err=True)):
            progress(f"playing {bag.name}", count / total)
    click.echo(f"Published {count} messages of {bag}")


@click.command()
@click.option("--node", default="/geomid", show_default=True, metavar="NAME", help="Node to show.")
@click.option(
    "--port", type=click.IntRange(1, 65535), help="Port of the page.  [default: 8765, or any free one if that is taken]"
)
def dashboard(node: str, port: int | None) -> None:
    """Show a running node on a local page.

    Shows masses with their intervals, fit, gaps and diagnostics. The page is on 127.0.0.1, not visible from the
    network. It is read-only and needs no network. Ctrl+C ends it.
    """
    with needing_ros("the dashboard"):
        from geomid_ros.ros.dashboard import run_dashboard
    run_dashboard(node, port, lambda line: click.echo(printable(line)))
