"""``geomid prior``: inertials for a URDF from its shapes and the robot's total mass."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element

import click

from geomid_ros.commands.options import PATH, Names, Output, options_of
from geomid_ros.commands.terminal import plain_table, progress_bar, results_console
from geomid_ros.errors import InputError, check_name
from geomid_ros.session.options import PackageOptions

if TYPE_CHECKING:
    from geomid_ros.files.shapes import ShapeReader
    from geomid_ros.model.robot import Robot
    from geomid_ros.model.shape_prior import LinkPrior, ShapePrior, Solid
    from geomid_ros.model.urdf_tree import UrdfTree

# Densities of machines, from thin covers to more than solid steel. Beyond them, the units of a mesh are suspect.
_LIGHTEST, _HEAVIEST = 50.0, 20_000.0  # [kg/m^3]


@click.command()
@click.argument("urdf", type=PATH)
@click.option("--mass", type=click.FloatRange(0.0, min_open=True), required=True, help="Total mass of all links [kg].")
@click.option(
    "--keep", type=Names(), help="Links to leave unchanged, separated by commas; their mass counts towards --mass."
)
@options_of(PackageOptions)
@click.option(
    "--out",
    type=Output(within=True, dir_okay=False),
    default=Path("prior.urdf"),
    show_default=True,
    help="URDF to write.",
)
def prior(urdf: Path, mass: float, keep: list[str] | None, package_path: dict[str, Path], out: Path) -> None:
    """Compute prior inertials of a URDF from its shapes.

    Fills the shapes of every link with one density, so that the total mass is --mass. Uses collision shapes, or visual
    ones if a link has no others. A mesh that is not closed counts as its convex hull. Links without shapes are left
    unchanged. The result is a prior for identification, not an estimate.
    """
    from geomid_ros.files.disk import write_text
    from geomid_ros.files.models.urdf import read_urdf, with_absolute_files, with_inertials
    from geomid_ros.files.shapes import ShapeReader
    from geomid_ros.model.robot import Robot
    from geomid_ros.model.shape_prior import ShapedUrdf, shape_prior

    text = read_urdf(urdf)
    robot = ShapedUrdf(text, str(urdf))
    kept = keep or []
    for name in kept:
        check_name("link to keep", name, robot.links)
    reader = ShapeReader(urdf, package_path)
    solids = _solids(reader, {name: link for name, link in robot.links.items() if name not in kept})
    robot.check_staying(solids)
    result = shape_prior(robot.inertials, solids, mass, str(urdf))
    inertias = {link.name: link.parameters for link in result.links if link.parameters is not None}
    written = with_inertials(with_absolute_files(text, str(urdf)), inertias)
    write_text(out, written)
    _show(result, kept)
    warnings = [*reader.warnings, *_warnings(result, robot.tree)]
    files = [out]
    try:
        placed = Robot(written, source=str(out))
    except InputError as error:
        warnings.append(f"geomid identify will refuse this URDF: {error}")
    else:
        files.append(out.with_suffix(".png"))
        with progress_bar() as progress:
            progress("drawing", 0.0)
            _draw(files[-1], placed, result)
    for warning in warnings:
        click.echo(f"Warning: {warning}", err=True)
    click.echo(f"\nWritten: {', '.join(map(str, files))}")


def _solids(reader: ShapeReader, links: dict[str, Element]) -> dict[str, Solid]:
    """Read the shapes of the links that have any."""
    solids = {}
    with progress_bar() as progress:
        for index, (name, link) in enumerate(links.items()):
            progress("reading shapes", index / len(links))
            if solid := reader.solid(link):
                solids[name] = solid
    return solids


def _warnings(result: ShapePrior, tree: UrdfTree) -> Iterator[str]:
    """Yield warnings about the result."""
    from geomid_ros.model.shape_prior import IMPOSSIBLE, massless_links

    if not _LIGHTEST <= result.density <= _HEAVIEST:
        yield (
            f"a density of {result.density:.3g} kg/m³ is out of range for a machine. Check the mass, the units of the "
            "meshes (metres; attribute scale), and whether all shapes belong to the robot (else --keep their links)"
        )
    impossible = [link.name for link in result.links if link.parameters is None and link.verdict == IMPOSSIBLE]
    if impossible:
        yield f"links left with inertials that are not physically consistent: {', '.join(impossible)}"
    between, last = massless_links(tree, {link.name: link.mass for link in result.links})
    if last:
        yield (
            f"these moving links, and everything attached to them, have neither a shape nor a mass: {', '.join(last)}"
            ". Add shapes or inertials; a joint that moves no mass has no dynamics"
        )
    if between:
        yield f"massless links, which is right only between the axes of one joint: {', '.join(between)}"


def _draw(path: Path, robot: Robot, result: ShapePrior) -> None:
    """Draw the links in the zero pose of the robot."""
    import numpy as np

    from geomid_ros.model.samples import samples_of
    from geomid_ros.report.pictures import PlacedLink, prior_picture

    frames = robot.link_frames(samples_of(np.zeros((3, 1, len(robot.joints)))))
    title = f"{robot.name}: {result.mass:.4g} kg in shapes of {result.density:.4g} kg/m³"
    prior_picture(path, title, [PlacedLink(link, *frames[link.name]) for link in result.links])


def _show(prior: ShapePrior, kept: Sequence[str]) -> None:
    """Print the links of a prior made from shapes, before and after."""
    from geomid_ros.model import shapes

    table = plain_table(
        f"Links filled with {prior.density:.4g} kg/m³",
        ["\nlink", "\nshape"],
        ["volume\n[litre]", "mass [kg]\nURDF", "\nprior"],
        ["the URDF's\ninertial"],
    )
    for link in prior.links:
        before = "" if link.before.parameters is None else f"{link.before.mass:.3f}"
        after = f"{link.mass:.3f}" if link.mass else ""
        volume = f"{1000.0 * shapes.volume(link.solid.moments):.3f}" if link.solid else ""
        table.add_row(link.name, _shape(link, kept), volume, before, after, link.verdict or "plausible")
    table.add_section()
    table.add_row("total", "", "", f"{sum(link.before.mass for link in prior.links):.3f}", f"{prior.mass:.3f}", "")
    results_console().print(table)


def _shape(link: LinkPrior, kept: Sequence[str]) -> str:
    if link.name in kept:
        return "kept"
    return link.solid.shape if link.solid else "none, unchanged"
