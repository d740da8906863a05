"""Run the command line, either in its own process or in that of the tests."""

import os
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from unittest.mock import patch

from acoustube.cli import main

COMMAND = str(Path(sys.executable).with_name("acoustube"))


def run_process(*words, **environment):
    """Run the installed command in its own process, in the current folder."""
    return subprocess.run(
        [COMMAND, *map(str, words)],
        capture_output=True,
        text=True,
        timeout=600,
        env=os.environ | environment,
        check=False,
    )


def run_here(*words, **environment):
    """Run the command in this process, which saves the one or two seconds of loading it."""
    out, error = StringIO(), StringIO()
    with patch.dict(os.environ, environment), redirect_stdout(out), redirect_stderr(error):
        code = main([str(word) for word in words])
    return subprocess.CompletedProcess(words, code, out.getvalue(), error.getvalue())
