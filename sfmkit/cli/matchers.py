"""``sfmkit matchers``: the table of matchers."""

from __future__ import annotations

import click


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def matchers(as_json: bool) -> None:
    """List the matchers, and whether they are available here."""
    from ..matching import list_matchers
    from .summary import print_matchers

    rows = list_matchers()
    if as_json:
        import json
        from dataclasses import asdict

        click.echo(json.dumps([asdict(row) for row in rows], indent=1))
    else:
        print_matchers(rows)
