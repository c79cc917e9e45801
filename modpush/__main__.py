"""`python -m modpush` is the command `modpush`."""

import sys

from modpush.cli.command import run_command

if __name__ == "__main__":
    sys.exit(run_command())
