"""The command ``acoustube``, also as ``python -m acoustube``."""

import os
import signal
import sys


def entry() -> None:
    """Run the command line and leave with its exit code.

    An interrupt at any moment, also while modules are being loaded, ends in one sentence. A request
    to terminate counts as one, so that a batch system leaves no half-written folder either.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        from acoustube.base.console import watched_interrupts

        with watched_interrupts():
            from acoustube.base.cache import keep_compiled_code

            keep_compiled_code()
            from acoustube.cli._app import main

            code = main()
    except KeyboardInterrupt:
        print("acoustube: interrupted", file=sys.stderr)
        code = 130
    if code == 130:
        # Python would wait for, or pull the ground from under, kernels that still run.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


if __name__ == "__main__":
    entry()
