"""Files that ship inside the package."""

from __future__ import annotations

from importlib.resources import files


def package_bytes(package: str, name: str) -> bytes:
    """Return the content of a file that ships in a package.

    Args:
        package: Full name of the package.
        name: Name of the file.
    """
    return (files(package) / name).read_bytes()
