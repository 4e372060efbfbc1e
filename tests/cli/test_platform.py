"""Native Windows is refused in one line; nothing that it lacks is loaded before."""

from __future__ import annotations

import subprocess
import sys

# As Windows has it: another name of the platform, no locks of files, no limits of processes, and no SIGHUP.
AS_ON_WINDOWS = """
import runpy, signal, sys
del signal.SIGHUP
sys.platform = "win32"
sys.modules["fcntl"] = sys.modules["resource"] = None
sys.argv = ["upvl", "check"]
runpy.run_module("upvl_cli", run_name="__main__")
"""


def test_windows_gets_one_line_that_says_wsl() -> None:
    found = subprocess.run([sys.executable, "-c", AS_ON_WINDOWS], capture_output=True, text=True, timeout=60)
    assert found.returncode == 2 and found.stdout == ""
    assert found.stderr.count("\n") == 1 and "WSL" in found.stderr
