"""Read what a workspace made, as tables of pyarrow.

Labels, detections, tracks and flow need the Parquet files alone; queries need the settings of the workspace, and points
and recordings the drives as well.
"""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from upvl_cli.errors import BadSetting, NotMade, one_line

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

    from upvl_cli.pipeline.workspace import Workspace
    from upvl_cli.viewer.drive_tables import DriveTables

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

    def __init__(self, out: str | PathLike[str], stages: str | PathLike[str] | None = None) -> None:
        """Open a folder of results, such as `out`.

        Args:
            out: The folder of the results.
            stages: The folder of the settings, which queries, points and recordings need; None takes the folder
                `stages` beside `out`.

        Raises:
            BadSetting: The folder is not there, or holds no results of upvl.
        """
        self._out = Path(out)
        self._stages = self._out.absolute().parent / "stages" if stages is None else Path(stages)
        self._opened: DriveTables | None = None
        if not self._out.is_dir():
            raise BadSetting(f"{self._out} is no folder; name the folder of the results, such as out")
        if not any(self._shards(stage) for stage in _HOW_TO_MAKE):
            raise BadSetting(
                f"{self._out} holds no results of upvl; expected for example {self._out}/labels/*.parquet: run "
                "upvl autolabel, or name the folder that it wrote"
            )

    @property
    def segments(self) -> tuple[str, ...]:
        """Names of the drives that have results."""
        return tuple(sorted({name for stage in _HOW_TO_MAKE for name in self._shards(stage)}))

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

    def to_pandas(self, segment: str | None = None) -> pd.DataFrame:
        """Return the auto labels of one drive, or of all, as a data frame of pandas; arguments as for `labels`.

        Raises:
            BadSetting: pandas is not installed, or there is no such drive.
        """
        try:
            import pandas  # noqa: F401
        except ImportError as error:
            raise BadSetting("to_pandas needs the package pandas; run: pip install pandas") from error
        return self.labels(segment).to_pandas()

    def query(self, phrases: str | Sequence[str], **options: Any) -> pa.Table:
        """Return the boxes that phrases find, best first, as `upvl query` finds them: one row a box.

        The first query writes the search index, `out/query/index/labels-*.arrow`; later ones read it.

        Args:
            phrases: Phrases to find, such as "fire truck"; commas separate several.
            **options: The filters `segments`, `moving`, `min_speed_mps`, `max_speed_mps`, `max_range_m`, `from_s`,
                `to_s` and `min_confidence`; `on` ("labels" or "detections"); `check_spelling` (True or False); and
                any setting of query.toml, such as `threshold`.

        Raises:
            BadSetting: A word is likely misspelt, or an option or a drive is unknown.
            NotMade: There is nothing to search yet.
        """
        from upvl_cli.query.run import all_hits
        from upvl_cli.results.requests import request_of

        return all_hits(self.workspace, request_of(phrases, options))

    def points(self, segment: str, frame: int) -> pa.Table:
        """Return the points of one frame with what was made of them, one row a point.

        Columns are `x_m`, `y_m`, `z_m` in ego axes, `intensity`, and where they were made `flow_x_mps`, `flow_y_mps`,
        `flow_z_mps`, `height_m`, `is_ground`, `is_moving`, `background` and `word` (of `semantics`; else that of the
        label that holds the point, None for none).

        Args:
            segment: Name of the drive.
            frame: Number of the frame.

        Raises:
            BadSetting: There is no such drive or frame.
            BadInput: The drive cannot be read.
        """
        from upvl_cli.results.point_table import point_table
        from upvl_cli.viewer.drive_tables import DriveTables

        if self._opened is None or self._opened.segment != segment:
            self._opened = DriveTables(self.workspace, segment)
        return point_table(self._opened, frame)

    def to_rerun(
        self,
        path: str | PathLike[str] | None = None,
        segment: str | None = None,
        frame_range: tuple[int, int] | None = None,
    ) -> Path | None:
        """Write a drive as a recording for the viewer of Rerun, or show it in the viewer's window.

        Args:
            path: The file, which ends in .rrd; None opens the window.
            segment: Name of the drive; None takes the first one.
            frame_range: First and last frame; None takes all.

        Returns:
            The file; None for a window.

        Raises:
            BadSetting: The package rerun is not installed, there is no such drive, or no display for a window.
        """
        from upvl_cli.results.recordings import save_recording, show_recording

        name = self.segments[0] if segment is None else segment
        if path is None:
            show_recording(self.workspace, name, frame_range)
            return None
        return save_recording(self.workspace, name, frame_range, Path(path))

    @cached_property
    def workspace(self) -> Workspace:
        """The workspace of the results: its settings, drives and model.

        Raises:
            BadSetting: The folder of the settings is not there.
        """
        from upvl_cli.results.opened_workspace import open_workspace

        return open_workspace(self._out, self._stages)

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
