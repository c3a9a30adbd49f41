"""The `pkm_cnc` command: one file per subcommand, errors as one line on stderr, exit 2 for bad input, 1 for a fault."""

from pkm_cnc.cli.command import main

__all__ = ["main"]
