"""``geomid excite``: motions that tell what a robot weighs."""

from __future__ import annotations

import click

from geomid_ros.commands.excite.run import run


@click.group()
def excite() -> None:
    """Move so that much can be learned."""


excite.add_command(run)
