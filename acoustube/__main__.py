"""Let ``python -m acoustube`` be the command ``acoustube``."""

import sys

from acoustube.cli import main

if __name__ == "__main__":
    sys.exit(main())
