"""The `pkm_cnc` command: one file per subcommand, errors as one line on stderr, exit 2 for bad input, 1 for a fault."""

import sys
from collections.abc import Sequence

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status. Ctrl-C is answered while the rest is still being imported, too."""
    try:
        from pkm_cnc.cli import command

        return command.main(arguments)
    except KeyboardInterrupt:
        print("pkm_cnc: stopped by SIGINT", file=sys.stderr)
        return 1
