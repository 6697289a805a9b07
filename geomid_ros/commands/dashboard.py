"""``geomid dashboard``: a running node on a local page."""

from __future__ import annotations

import click

from geomid_ros.errors import InputError, printable


@click.command()
@click.option("--node", default="/geomid", show_default=True, metavar="NAME", help="The node that is shown.")
@click.option(
    "--port", type=click.IntRange(1, 65535), help="Port of the page.  [default: 8765, or if that is taken any other]"
)
def dashboard(node: str, port: int | None) -> None:
    """Show a running node on a local page.

    Masses with their intervals, fit, gaps and diagnostics, as they come. The page is on 127.0.0.1: nobody on the
    network sees it. It needs no network, and only shows: nothing can be changed there. Ends with Ctrl+C.
    """
    try:
        from geomid_ros.ros.dashboard_listener import run_dashboard
    except ImportError as error:
        raise InputError(f"the dashboard needs ROS 2 and Tornado, and cannot import them ({error})") from error
    run_dashboard(node, port, lambda said: click.echo(printable(said)))
