"""``geomid dashboard``: a running node on a local page."""

from __future__ import annotations

import click

from geomid_ros.errors import needing_ros, printable


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
    run_dashboard(node, port, lambda said: click.echo(printable(said)))
