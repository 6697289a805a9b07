"""Options that commands share, of those which read bags above all."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from pathlib import Path
from typing import Any, TypeAlias

import click

from geomid_ros.files.models.readers import DESCRIBED_FOR, URDF

Decorator: TypeAlias = Callable[[Callable[..., Any]], Callable[..., Any]]


class Output(click.Path):
    """Where results go: what cannot be written is told before any work is done.

    A folder, or with ``within`` what is made in its folder.
    """

    def __init__(self, *, within: bool = False, **options: Any) -> None:
        super().__init__(path_type=Path, **options)
        self._within = within

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        from geomid_ros.files.disk import check_writable

        path = Path(super().convert(value, param, ctx))  # type: ignore[arg-type]  # it is one
        check_writable(path.parent if self._within else path)
        return path


class Names(click.ParamType):  # type: ignore[type-arg]  # older releases of click take none
    """Names that are separated by commas; with ``or_none`` the word 'none' says that there are to be none.

    An empty name is refused: it comes of a variable of the shell that is not set, and nobody can tell what was meant.
    """

    name = "names"

    def __init__(self, *, or_none: bool = False) -> None:
        self._or_none = or_none

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> list[str]:
        names = [name.strip() for name in value.split(",")]
        if self._or_none and names == ["none"]:
            return []
        if not all(names):
            none = ", or 'none' for none" if self._or_none else ""
            self.fail(
                f"there is an empty name in '{value}'. Write NAME,NAME,...{none}; or omit the option.", param, ctx
            )
        return names


OUT: dict[str, Any] = {
    "type": Output(file_okay=False),
    "show_default": True,
    "help": "Output folder.",
}
UNTRIED_OUT = OUT | {"type": click.Path(path_type=Path, file_okay=False)}
"""The same for commands that do not always write: they try it themselves."""
PATH = click.Path(path_type=Path)


def together(options: Sequence[Decorator]) -> Decorator:
    """Several options as one decorator; help lists the last one first."""
    return lambda command: reduce(lambda inner, option: option(inner), options, command)


def _packages(_context: click.Context, _option: click.Parameter, texts: tuple[str, ...]) -> dict[str, Path]:
    """Folders by package name, of NAME=FOLDER."""
    packages = {}
    for text in texts:
        name, _, folder = text.partition("=")
        if not name or not folder:
            raise click.BadParameter(f"'{text}' is not of the form NAME=FOLDER")
        packages[name] = Path(folder)
    return packages


joint_topic_option = click.option(
    "--joint-topic", default="joint_states", show_default=True, help="Topic of the joint states."
)
lock_option = click.option(
    "--lock", type=Names(), metavar="JOINTS", help="Joints that stay at zero, separated by commas."
)
xacro_option = click.option(
    "--xacro-arg", "xacro_args", multiple=True, metavar="NAME:=VALUE", help="Xacro argument; may be repeated."
)
description_options = together(
    [
        lock_option,
        click.option(
            "--gain",
            multiple=True,
            metavar="[JOINT=]FACTOR",
            help="Factor from message efforts to N m (or N), for all joints or one; may be repeated.",
        ),
        click.option(
            "--gravity", nargs=3, type=float, metavar="X Y Z", help="Gravity in the base frame.  [default: 0 0 -9.81]"
        ),
        click.option("--config", type=PATH, help="The node's parameter file (YAML)."),
        xacro_option,
    ]
)
"""The options that say which robot it is, but ``--urdf``, as :class:`~geomid_ros.api.options.RobotOptions` has them."""

robot_options = together(
    [
        click.option("--odom-topic", default="odom", show_default=True, help="Topic of the base pose."),
        click.option("--floating-base", is_flag=True, help="The base moves; its pose is read from the odometry topic."),
        click.option(
            "--contacts",
            type=Names(),
            metavar="FEET",
            help="Feet on the ground, FRAME or FRAME:RADIUS [m], separated by commas; the efforts of their legs tell "
            "their forces.",
        ),
        click.option("--imu", metavar="TOPIC:FRAME", help="IMU on a moving base, in place of its pose."),
        click.option(
            "--wrench",
            multiple=True,
            metavar="TOPIC:FRAME:ROLE[:AXES]",
            help="Wrench topic; ROLE is mounted or external, -ROLE reverses the sign; AXES as in fz,tx,ty.",
        ),
        click.option(
            "--gains",
            multiple=True,
            metavar="[JOINT=]KP:KD",
            help="Gains of motors without torque sensors, whose efforts are those of --command, or a parameter file of "
            "a joint_trajectory_controller; may be repeated.",
        ),
        click.option(
            "--command",
            metavar="TOPIC",
            help="Topic of the recorded joint set-points (JointState); identify and gap simulate under them.",
        ),
        joint_topic_option,
        click.option("--merge", is_flag=True, help="Several publishers send joint states, each for some joints."),
        click.option("--alike", type=click.Choice(("urdf", "none")), help="Links that err alike.  [default: urdf]"),
        click.option("--cutoff", type=float, metavar="HZ", help="Cutoff of the low-pass filter on all signals."),
        description_options,
        click.option(
            "--urdf",
            type=PATH,
            help="Robot description, URDF or .xacro.  [default: robot_description in the bags]",
        ),
    ]
)
"""The same, and what is measured on the robot and how that is read."""

recording_options = together(
    [
        click.option("--validate", multiple=True, type=PATH, help="Bag to test on; may be repeated."),
        click.option(
            "--hold-out",
            type=click.FloatRange(0.0, 0.9),
            help="Share of each bag, at its end, held out for testing.  [default: 0.3; 0 with --validate]",
        ),
        click.option(
            "--model",
            type=PATH,
            help="Start from this estimate.json. Without --urdf, identified.urdf in the same folder is used.",
        ),
    ]
)
"""Further ones: which data are judged on, and where to start from."""

reader_option = click.option(
    "--for",
    "reader",
    type=click.Choice(DESCRIBED_FOR),
    default=URDF,
    show_default=True,
    help="Format of the robot description. The file is fitted with what the format can hold, loaded again, and tested "
    "on held-out data.",
)

report_option = click.option(
    "--report/--no-report",
    default=True,
    show_default=True,
    help="Write the page and the pictures, which are for people.",
)

package_option = click.option(
    "--package-path",
    multiple=True,
    metavar="NAME=FOLDER",
    callback=_packages,
    help="Folder of package://NAME, if not above the URDF, in ROS_PACKAGE_PATH or in AMENT_PREFIX_PATH; may be "
    "repeated.",
)
