"""Options that the commands of ``geomid excite`` share."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from geomid_ros.commands.options import PATH, joint_topic_option, lock_option, package_option, together, xacro_option
from geomid_ros.errors import InputError

if TYPE_CHECKING:
    from geomid_ros.session.collision_scene import Surroundings
    from geomid_ros.session.excitation import MotionRequest


surroundings_options = together(
    [
        package_option,
        click.option(
            "--collision/--no-collision",
            default=True,
            help="Whether to check for collisions; a URDF without shapes needs --no-collision.",
        ),
        click.option(
            "--clearance",
            default=0.02,
            show_default=True,
            type=click.FloatRange(0.0),
            help="Smallest distance between links, and to obstacles [m].",
        ),
        click.option(
            "--avoid",
            multiple=True,
            metavar="OBSTACLE",
            help="Obstacle: box:X,Y,Z,LENGTH,WIDTH,HEIGHT (X,Y,Z is its centre), plane:NX,NY,NZ,OFFSET (solid below) "
            "or a mesh file "
            "(each part counts as its convex hull), in metres in the base frame; may be repeated.",
        ),
    ]
)
"""What must not be touched; see :func:`surroundings_of`."""


def surroundings_of(options: dict[str, Any]) -> Surroundings:
    """What these options say, which are taken out of the ``options``."""
    from geomid_ros.session.collision_scene import Surroundings

    return Surroundings(
        avoid=options.pop("avoid"),
        clearance=options.pop("clearance"),
        collide=options.pop("collision"),
        packages=options.pop("package_path"),
    )


motion_options = together(
    [
        surroundings_options,
        click.option("--seed", default=0, show_default=True, help="Random seed; another seed finds another motion."),
        lock_option,
        click.option(
            "--wrench",
            multiple=True,
            metavar="TOPIC:FRAME:ROLE[:AXES]",
            help="Wrench sensor that will be recorded, too; ROLE is mounted or external.",
        ),
        click.option(
            "--from",
            "model",
            type=PATH,
            help="Target what this estimate.json left uncertain; posterior.npz must be in the same folder.",
        ),
        click.option(
            "--for",
            "aim",
            default="prediction",
            show_default=True,
            metavar="AIM",
            help="What to identify: prediction (of efforts in other motions), friction, payload or link:NAME.",
        ),
        click.option(
            "--speed",
            default=0.5,
            show_default=True,
            type=click.FloatRange(0.0, 1.0, min_open=True),
            help="Largest speed, as a share of the velocity limits.",
        ),
        click.option(
            "--start",
            metavar="Q",
            help="Posture at both ends: one number for each joint, separated by commas.",
        ),
        click.option(
            "--repeats", default=2, show_default=True, type=click.IntRange(1, 20), help="Number of repetitions."
        ),
        click.option(
            "--duration",
            default=20.0,
            show_default=True,
            type=click.FloatRange(2.0, 600.0),
            help="Total duration [s].",
        ),
        click.option(
            "--limits",
            type=PATH,
            help="Joint limits, in the format of MoveIt's joint_limits.yaml.",
        ),
        xacro_option,
        click.option("--urdf", type=PATH, help="Robot description, URDF or .xacro."),
    ]
)
"""What a designed motion is asked for; see :func:`wish_of`."""


def wish_of(options: dict[str, Any]) -> MotionRequest:
    """What these options ask for, which are taken out of the ``options``."""
    from geomid_ros.session.excitation import MotionRequest

    own = {name: options.pop(name) for name in ("limits", "duration", "repeats", "speed", "aim", "seed")}
    return MotionRequest(start=numbers(options.pop("start")), surroundings=surroundings_of(options), **own)


robot_run_options = together(
    [
        click.option("--execute", is_flag=True, help="Move the robot; without it nothing moves."),
        click.option(
            "--silence",
            type=click.FloatRange(0.0, min_open=True),
            help="Stop if no joint states arrive for this time [s].  [default: 0.04, or three of their periods if "
            "that is "
            "longer]",
        ),
        click.option(
            "--tolerance",
            default=0.1,
            show_default=True,
            type=click.FloatRange(0.0, min_open=True),
            help="Stop if a joint is this far off its trajectory [rad, m].",
        ),
        joint_topic_option,
        click.option(
            "--controller",
            default="/joint_trajectory_controller",
            show_default=True,
            help="Controller that follows the motion.",
        ),
    ]
)
"""Who moves the robot, and what stops it."""


def share_of(_context: click.Context, _option: click.Parameter, text: str | None) -> float:
    """A share of ``5%`` or ``0.05``."""
    try:
        share = float((text or "0").removesuffix("%")) / (100.0 if (text or "").endswith("%") else 1.0)
    except ValueError:
        share = -1.0
    if not 0.0 <= share < 1.0:
        raise click.BadParameter(f"'{text}' is not a share; expected e.g. 5%")
    return share


def numbers(text: str | None) -> list[float]:
    """Numbers that are separated by commas, none for no text. Raises InputError."""
    try:
        return [] if text is None else [float(part) for part in text.split(",")]
    except ValueError as error:
        raise InputError(f"--start is '{text}', expected numbers separated by commas") from error
