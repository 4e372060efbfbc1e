"""The package rerun, which is an extra."""

from __future__ import annotations

from typing import Any

from upvl_cli.errors import BadSetting


def rerun_library() -> Any:
    """Return the module `rerun`.

    Raises:
        BadSetting: It is not installed.
    """
    try:
        import rerun
    except ImportError as error:
        raise BadSetting("the viewer needs the package rerun; run: pip install 'upvl[view]'") from error
    return rerun
