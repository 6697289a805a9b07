"""What ``geomid excite`` does without a subcommand: design a motion."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from geomid_ros.commands.options import UNTRIED_OUT, package_option
from geomid_ros.errors import InputError

if TYPE_CHECKING:
    from geomid_ros.session.excitation import Excitation


def design_options(function: Callable[..., None]) -> Callable[..., None]:
    """The options of a design."""
    command = function
    for option in (
        click.option("--out", default=Path("geomid_excite"), **UNTRIED_OUT),
        click.option("--seed", default=0, show_default=True, help="Of the search; another one finds another motion."),
        package_option,
        click.option("--no-collision", is_flag=True, help="Do not look for collisions, e.g. of a URDF without shapes."),
        click.option("--lock", default="", metavar="JOINTS", help="These joints stand at zero; separated by commas."),
        click.option(
            "--until",
            metavar="SHARE",
            callback=_share,
            help="Write nothing if the motion would lower the expected error by less than this, e.g. 5%.",
        ),
        click.option(
            "--settle",
            type=click.Path(path_type=Path),
            help="Tell the rivals apart that this gap.json names.",
        ),
        click.option(
            "--from",
            "model",
            type=click.Path(path_type=Path),
            help="Learn what this estimate.json does not know yet; posterior.npz is read beside it.",
        ),
        click.option(
            "--for",
            "aim",
            default="prediction",
            show_default=True,
            metavar="AIM",
            help="prediction (of the efforts in other motions), friction, payload or link:NAME.",
        ),
        click.option(
            "--speed",
            default=0.5,
            show_default=True,
            type=click.FloatRange(0.0, 1.0, min_open=True),
            help="Share of the velocity limits.",
        ),
        click.option(
            "--clearance",
            default=0.02,
            show_default=True,
            type=click.FloatRange(0.0),
            help="Least distance of links from each other and from obstacles [m].",
        ),
        click.option(
            "--avoid",
            multiple=True,
            metavar="OBSTACLE",
            help="box:X,Y,Z,LENGTH,WIDTH,HEIGHT (its centre), plane:NX,NY,NZ,OFFSET (solid below) or a mesh file, in "
            "metres in the base frame; may be repeated.",
        ),
        click.option(
            "--start",
            default="",
            metavar="Q",
            help="Where it begins and ends: one number for each joint, separated by commas.",
        ),
        click.option(
            "--repeats", default=2, show_default=True, type=click.IntRange(1, 20), help="How often a period is run."
        ),
        click.option(
            "--duration",
            default=20.0,
            show_default=True,
            type=click.FloatRange(2.0, 600.0),
            help="Of all periods together [s].",
        ),
        click.option("--limits", type=click.Path(path_type=Path), help="joint_limits.yaml, as MoveIt has it."),
        click.option("--xacro-arg", "xacro_args", multiple=True, metavar="NAME:=VALUE", help="For a xacro."),
        click.option("--urdf", type=click.Path(path_type=Path), help="The robot's description, URDF or .xacro."),
    ):
        command = option(command)
    return command


def design(
    *,
    urdf: Path | None,
    xacro_args: tuple[str, ...],
    model: Path | None,
    lock: str,
    start: str,
    no_collision: bool,
    package_path: dict[str, Path],
    until: float,
    out: Path,
    **options: Any,
) -> None:
    """Design a motion, print what to expect of it, and write it."""
    from geomid_ros.api.arguments import description
    from geomid_ros.commands.progress import progress_bar
    from geomid_ros.commands.results import excitation as results
    from geomid_ros.files.disk import check_writable
    from geomid_ros.report.excitation import save
    from geomid_ros.session import excitation
    from geomid_ros.session.configuration import Configuration

    check_writable(out)
    if urdf is None and model is None:
        raise InputError("no robot is given: add --urdf ROBOT.urdf (or --from estimate.json, with identified.urdf)")
    robot = description(urdf, [], model=model, xacro_args=xacro_args)
    wish = excitation.Wish(start=_numbers(start), collide=not no_collision, packages=package_path, **options)
    values: dict[str, Any] = {"locked_joints": [name.strip() for name in lock.split(",") if name.strip()]}
    if model is not None:
        values["model"] = str(model)
    with progress_bar() as progress:
        task = excitation.task_of(robot.text, Path(robot.source), Configuration(values, "options"), wish)
        found = excitation.design(task, wish, progress)
        worth_it = found.learning.gain >= until
        progress("writing", 0.0)
        files = save(found, out) if worth_it else []
    results.show(found)
    said = f"Written: {', '.join(map(str, files))}" if worth_it else f"Nothing is written: {_not_worth(found, until)}"
    click.echo(f"\n{said}")


def _not_worth(found: Excitation, until: float) -> str:
    gain = max(found.learning.gain, 0.0)
    return f"{found.motion.form.duration:g} s more would lower the expected error by {gain:.1%}, less than {until:.3g}"


def _share(_context: click.Context, _option: click.Parameter, text: str | None) -> float:
    """A share of ``5%`` or ``0.05``."""
    try:
        share = float((text or "0").removesuffix("%")) / (100.0 if (text or "").endswith("%") else 1.0)
    except ValueError:
        share = -1.0
    if not 0.0 <= share < 1.0:
        raise click.BadParameter(f"'{text}' is no share; expected e.g. 5%")
    return share


def _numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")] if text.strip() else []
    except ValueError as error:
        raise InputError(f"--start is '{text}', expected numbers that are separated by commas") from error
