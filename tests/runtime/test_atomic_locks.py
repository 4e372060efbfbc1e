"""Writing on a file system without locks: a warning, and on. The kernel itself refuses the lock in these tests."""

from __future__ import annotations

import platform
import subprocess
import sys
from pathlib import Path

import pytest

FLOCK = {"x86_64": 73, "aarch64": 32}  # the number of the system call

# A filter of system calls: flock ends with an error number, all else goes on. See seccomp(2).
WITHOUT_LOCKS = """
import ctypes, struct, sys
flock, error = int(sys.argv[1]), int(sys.argv[2])
code = [(0x20, 0, 0, 0), (0x15, 0, 1, flock), (0x06, 0, 0, 0x00050000 | error), (0x06, 0, 0, 0x7FFF0000)]
rules = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *line) for line in code))
program = ctypes.create_string_buffer(struct.pack("HxxxxxxP", len(code), ctypes.addressof(rules)))
libc = ctypes.CDLL(None, use_errno=True)
if libc.prctl(38, 1, 0, 0, 0) or libc.prctl(22, 2, program, 0, 0):
    sys.exit(77)
from pathlib import Path
from upvl_cli.errors import UpvlError
from upvl_cli.runtime.atomic import atomic_file
try:
    for name in sys.argv[3:]:
        with atomic_file(Path(name)) as file:
            file.write(b"written")
except UpvlError as error:
    sys.exit(f"refused: {error}")
"""


def write_without_locks(error: int, *paths: Path) -> subprocess.CompletedProcess[str]:
    if platform.machine() not in FLOCK or sys.platform != "linux":
        pytest.skip("the filter of system calls is written for Linux on two kinds of processors")
    number = str(FLOCK[platform.machine()])
    command = [sys.executable, "-c", WITHOUT_LOCKS, number, str(error), *map(str, paths)]
    found = subprocess.run(command, capture_output=True, text=True, timeout=60)
    if found.returncode == 77:
        pytest.skip("this system lets no process filter its system calls")
    return found


@pytest.mark.parametrize("error", [37, 38, 95], ids=["ENOLCK", "ENOSYS", "EOPNOTSUPP"])
def test_without_locks_files_are_written_after_one_warning(tmp_path: Path, error: int) -> None:
    paths = [tmp_path / "a", tmp_path / "b"]
    found = write_without_locks(error, *paths)
    assert found.returncode == 0, found.stderr
    assert [path.read_bytes() for path in paths] == [b"written"] * 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]
    assert found.stderr.count("\n") == 1
    assert found.stderr.startswith(f"upvl: warning: the file system of {tmp_path} has no locks")


def test_any_other_error_of_a_lock_is_one(tmp_path: Path) -> None:
    found = write_without_locks(5, tmp_path / "a")  # EIO
    assert found.returncode == 1 and found.stderr.startswith(f"refused: cannot write {tmp_path / 'a'}")
    assert not (tmp_path / "a").exists()
