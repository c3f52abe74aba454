"""``python -m torchgrasp`` is the command ``torchgrasp``."""

import sys

from torchgrasp.commands.command_line import main

if __name__ == "__main__":
    sys.exit(main())
