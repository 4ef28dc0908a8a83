"""The command line: each command in a file of its own subject, found here."""

from __future__ import annotations

import sys
from importlib import import_module

from albedo.cli.app import INTERRUPTED, app

__all__ = ["app", "main"]

# In the order of the help.
for _subject in (
    "models",
    "albedos",
    "operators",
    "stability",
    "costs",
    "lookups",
    "checks",
    "studies",
):
    import_module(f"{__name__}.{_subject}")


def main() -> None:
    """Run the command line; the entry point of the ``albedo`` script."""
    try:
        app()
    except KeyboardInterrupt:
        # Interrupted before a command began or after it ended.
        sys.exit(INTERRUPTED)
