"""The library py123d: what it needs before it reads, and its errors as one line."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from py123d.api.scene.arrow.arrow_scene_api import ArrowSceneAPI
from py123d.api.utils.arrow_helper import get_lru_cached_arrow_table, open_arrow_schema
from py123d.common.runtime import CacheSettings, setup_cache_settings
from py123d.datatypes import ModalityType

from upvl_cli.datasets.shared.poses import check_pose, quaternion_rotation, rigid
from upvl_cli.errors import BadInput, one_line
from upvl_cli.types import Array

_MAX_TIME_US = 2**52  # the year 144 000
_MAX_REASON = 300  # characters of the library's own message
# Each keeps a file open, and a system allows a thousand open files; a log has about twenty.
_MAX_OPEN_TABLES = 256
_TABLES_VARIABLE = "PY123D_MAX_LRU_CACHED_TABLES"

# The library logs what it skips; here a file that it skips is an error, which is told once.
logging.getLogger("py123d").addHandler(logging.NullHandler())
if _TABLES_VARIABLE not in os.environ:
    setup_cache_settings(CacheSettings(max_lru_cached_tables=_MAX_OPEN_TABLES))


@contextmanager
def library_errors(where: object) -> Iterator[None]:
    """Raise whatever the library raises as `BadInput`.

    Args:
        where: What is read, for the message.
    """
    try:
        with np.errstate(all="ignore"):
            yield
    except BadInput:
        raise
    # The library and its decoders are foreign code: on damaged logs they raise assertions, and errors of Arrow,
    # OpenCV, msgpack, laspy and others. A bug of ours does not pass here: the block holds calls of the library alone.
    except Exception as error:
        reason = f"{type(error).__name__}: {one_line(error)}"[:_MAX_REASON]
        raise BadInput(
            f"{where} cannot be read by py123d ({reason}); convert the log again, or set the root of the source "
            "data set if the log refers to its files (docs/datasets/py123d.md)"
        ) from None


@dataclass(frozen=True, eq=False)
class ArrowLog:
    """One log: a folder with a file `<modality>.arrow` for each of its modalities.

    Attributes:
        folder: The folder.
        scene: The whole log as the library reads it.
        metadatas: What the library found, by modality: its description of each.
    """

    folder: Path
    scene: ArrowSceneAPI
    metadatas: dict[str, Any]
    _tables: dict[str, pa.Table] = field(default_factory=dict)
    _times_us: dict[tuple[str, str], list[int | None]] = field(default_factory=dict)

    def path(self, key: str) -> Path:
        """Return the file of a modality."""
        return self.folder / f"{key}.arrow"

    def table(self, key: str) -> pa.Table:
        """Return the table of a modality, which the library maps into memory and whose offsets it trusts.

        Raises:
            BadInput: It is damaged.
        """
        if key not in self._tables:
            with library_errors(self.path(key)):
                table = get_lru_cached_arrow_table(self.path(key))
                table.validate(full=True)
            self._tables[key] = table
        return self._tables[key]

    def column(self, iteration: int, key: str, name: str, *, decode: bool = False) -> Any:
        """Return one cell of a modality at an iteration; None where it has none there."""
        metadata = self.metadatas[key]
        with library_errors(f"{self.path(key)}, iteration {iteration}"):
            return self.scene.get_modality_column_at_iteration(
                iteration, name, metadata.modality_type, metadata.modality_id, deserialize=decode
            )

    def times_us(self, key: str, name: str = "timestamp_us") -> list[int | None]:
        """Return the time of a modality at each iteration, in microseconds; None where it has nothing there.

        The table of iterations has for each modality the row of its own table.

        Raises:
            BadInput: A row is not there, or a time is none.
        """
        if (key, name) not in self._times_us:
            rows, table = self.table("sync"), self.table(key)
            times_us: list[Any] = [None] * rows.num_rows
            with library_errors(f"{self.path('sync')}, column {key}"):
                if key in rows.column_names:
                    times_us = table[f"{key}.{name}"].take(rows[key].cast("int64")).to_pylist()
            for time in times_us:
                if time is not None and (not isinstance(time, int) or abs(time) >= _MAX_TIME_US):
                    raise BadInput(f"{self.path(key)}: {name} is {str(time)[:40]}, expected microseconds")
            self._times_us[key, name] = times_us
        return self._times_us[key, name]

    def keys(self, kind: ModalityType) -> list[str]:
        """Return the modalities of a kind, sorted."""
        return sorted(key for key, value in self.metadatas.items() if value.modality_type == kind)


def open_log(folder: Path) -> ArrowLog:
    """Return a log; its sensor data are not read yet.

    Raises:
        BadInput: It is damaged, or the library cannot read one of its descriptions.
    """
    log = ArrowLog(folder, ArrowSceneAPI(folder), {})
    log.table("sync")
    paths = sorted(folder.glob("*.arrow"))
    for path in paths:  # the library reads the descriptions of all, but would not say which one is damaged
        with library_errors(path):
            open_arrow_schema(path)
    with library_errors(folder):
        log.metadatas.update(log.scene.get_all_modality_metadatas())
        log.scene.get_scene_metadata()
    for kind in (ModalityType.EGO_STATE_SE3, ModalityType.LIDAR, ModalityType.CAMERA):
        name = kind.serialize()
        for path in paths:
            if path.stem.partition(".")[0] == name and path.stem not in log.metadatas:
                raise BadInput(
                    f"{path} has no description that py123d can read; convert the log again, or remove the file to "
                    "do without it"
                )
    return log


def pose_matrices(numbers: Array, where: str, **limits: float) -> Array:
    """Return the (..., 4, 4) of poses of the library, which are x, y, z and a quaternion.

    Args:
        numbers: (..., 7) the arrays of the library's `PoseSE3`.
        where: What they are, for the message.
        limits: Those of `check_pose`.

    Raises:
        BadInput: One is not rigid, or too far away.
    """
    rotation = quaternion_rotation(numbers[..., 3:], where)
    return check_pose(rigid(rotation, numbers[..., :3]), where, **limits)
