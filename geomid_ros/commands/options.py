"""Options that commands which read bags share, and the configuration that they make."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from geomid_ros.model.sensors import WrenchSensor
from geomid_ros.session.configuration import Configuration

URDF: dict[str, Any] = {"type": click.Path(path_type=Path), "help": "The robot's description."}


def recording_options(command: Any) -> Any:
    """The options that say what is measured on the robot, which data are tested on, and where to start from."""
    for option in (
        click.option(
            "--validate", multiple=True, type=click.Path(path_type=Path), help="A bag to test on; may be repeated."
        ),
        click.option(
            "--hold-out",
            type=click.FloatRange(0.0, 0.9),
            help="Share of each bag's time, at the end, kept to test on.  [default: 0.3, with --validate 0]",
        ),
        click.option("--odom-topic", default="odom", show_default=True, help="Topic of the base's pose."),
        click.option("--joint-topic", default="joint_states", show_default=True, help="Topic of the joint states."),
        click.option(
            "--wrench",
            multiple=True,
            metavar="TOPIC:FRAME:ROLE[:AXES]",
            help="A wrench topic; ROLE is mounted or external, -ROLE reverses its sign; AXES like fz,tx,ty.",
        ),
        click.option("--floating-base", is_flag=True, help="The base moves; its pose is read from the odometry topic."),
        click.option("--model", type=click.Path(path_type=Path), help="Start from this estimate.json."),
        click.option("--config", type=click.Path(path_type=Path), help="The node's parameter file (YAML)."),
    ):
        command = option(command)
    return command


def held_out_share(hold_out: float | None, validate: tuple[Path, ...]) -> float:
    """The share of each bag that is tested on."""
    return hold_out if hold_out is not None else (0.0 if validate else 0.3)


def configured(
    config: Path | None, model: Path | None, floating_base: bool, wrench: tuple[str, ...], **values: Any
) -> Configuration:
    """The configuration of a parameter file and of options, which win; ``values`` are further parameters."""
    configuration = Configuration.read(config) if config else Configuration(source="options")
    if model:
        values["model"] = str(model)
    if floating_base:
        values["floating_base"] = True
    if wrench:
        configuration = configuration.with_sensors([WrenchSensor.parse(text) for text in wrench])
    return configuration.with_values(Configuration(values, "options").given)
