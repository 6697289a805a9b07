"""``geomid excite``: motions that tell what a robot weighs. Without a subcommand it designs one."""

from __future__ import annotations

from typing import Any

import click

from geomid_ros.commands.excite.design import design, design_options
from geomid_ros.commands.excite.learn import learn
from geomid_ros.commands.excite.run import run


@click.group(invoke_without_command=True)
@design_options
@click.pass_context
def excite(context: click.Context, /, **options: Any) -> None:
    """Design an exciting trajectory.

    Writes an informative trajectory that is feasible at every instant: within the limits of position, speed,
    acceleration and jerk, within the effort limits with a margin for uncertain inertias, and with a clearance between
    all links and obstacles. It begins and ends at rest.
    """
    if context.invoked_subcommand is None:
        design(**options)


excite.add_command(run)
excite.add_command(learn)
