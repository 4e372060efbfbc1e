"""Read what a workspace made as tables of pyarrow; needs the Parquet files alone, no settings and no drives."""

from __future__ import annotations

import difflib
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from upvl_cli.errors import BadSetting, NotMade, one_line

if TYPE_CHECKING:
    import pyarrow as pa

_HOW_TO_MAKE = {
    "labels": "upvl autolabel",
    "detect": "upvl train, then: upvl detect",
    "track": "upvl autolabel",
    "flow": "upvl autolabel",
}


class Results:
    """The results in one folder. `to_pandas()` of each table works where pandas is installed.

    A table of boxes has one row a box: `segment`, `frame`, `time_ns`, `center_x_m`, ... in ego axes; the unit and the
    meaning of a column stand in the metadata of its field.
    """

    def __init__(self, out: str | PathLike[str]) -> None:
        """Open a folder of results, such as `out`.

        Raises:
            BadSetting: The folder is not there, or holds no results of upvl.
        """
        self._out = Path(out)
        if not self._out.is_dir():
            raise BadSetting(f"{self._out} is no folder; name the folder of the results, such as out")
        if not any(self._shards(stage) for stage in _HOW_TO_MAKE):
            raise BadSetting(
                f"{self._out} holds no results of upvl; expected for example {self._out}/labels/*.parquet: run "
                "upvl autolabel, or name the folder that it wrote"
            )

    def labels(self, segment: str | None = None) -> pa.Table:
        """Return the auto labels of one drive, or of all drives in the order of their names.

        Args:
            segment: Name of the drive.

        Raises:
            BadSetting: There is no such drive.
            NotMade: No labels have been made, or a file is damaged.
        """
        return self._table("labels", segment)

    def detections(self, segment: str | None = None) -> pa.Table:
        """Return the boxes of the detector, without the features of their points; arguments as for `labels`."""
        return self._table("detect", segment, without=("pooled", "point_feature"))

    def tracks(self, segment: str | None = None) -> pa.Table:
        """Return the tracked boxes, before they are made amodal and scored; arguments as for `labels`."""
        return self._table("track", segment)

    def flow(self, segment: str) -> pa.Table:
        """Return the scene flow of one drive: one row a frame, with the velocities of all its points in one list."""
        return self._table("flow", segment)

    def _shards(self, stage: str) -> dict[str, Path]:
        return {path.stem: path for path in sorted((self._out / stage).glob("*.parquet"))}

    def _table(self, stage: str, segment: str | None, without: tuple[str, ...] = ()) -> pa.Table:
        import pyarrow as pa

        shards = self._shards(stage)
        if not shards:
            raise NotMade(f"{self._out / stage} has no file; run: {_HOW_TO_MAKE[stage]}")
        if segment is None:
            return pa.concat_tables([_read(path, without) for path in shards.values()])
        if segment not in shards:
            close = difflib.get_close_matches(segment, shards, n=1)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            raise BadSetting(
                f"{self._out / stage} has no segment {segment!r}{hint} (it has {', '.join(shards)})"
            )
        return _read(shards[segment], without)


def _read(path: Path, without: tuple[str, ...]) -> pa.Table:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        # Closed by itself; one file, whatever the folders around it are called.
        file = pq.ParquetFile(path, page_checksum_verification=True)
        columns = [name for name in file.schema_arrow.names if name not in without]
        return file.read(columns).replace_schema_metadata(None)
    except (OSError, pa.ArrowException) as error:
        raise NotMade(f"{path} is damaged ({one_line(error)}); delete it and make it again") from None
