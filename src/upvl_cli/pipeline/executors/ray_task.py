"""What runs on a node of a Ray cluster: open the workspace as the driver has it, and make shards."""

from __future__ import annotations

import atexit
import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from upvl_cli.config.base import Config
from upvl_cli.errors import UpvlError
from upvl_cli.pipeline.executors.base import Failed, Job, Place, Started, Warned, Work, run_job
from upvl_cli.pipeline.runner import Made
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.runtime.parallel import THREADS_VARIABLE

Event = Started | Warned | Made | Failed


@dataclass(frozen=True)
class Arrived:
    """The node that a task runs on, as Ray numbers it."""

    node: str


Report = list[Arrived | Event]


@dataclass(frozen=True)
class Parcel:
    """What a node needs to open the workspace of the driver; the node need not have its folder of settings.

    Attributes:
        place: The workspace.
        values: Values of each stage, by its name.
        files: The TOML files of the folder of settings, by their paths below it.
        folders: The folders below it: a preset that changes nothing is an empty one.
    """

    place: Place
    values: Mapping[str, Config]
    files: Mapping[str, bytes]
    folders: tuple[str, ...]

    @classmethod
    def of(cls, work: Work) -> Parcel:
        """Return the parcel of a workspace that is open in this process."""
        place = Place.of(work.workspace)
        stages = place.stages
        below = sorted(stages.rglob("*"))
        files = {str(path.relative_to(stages)): path.read_bytes() for path in below if path.suffix == ".toml"}
        folders = tuple(str(path.relative_to(stages)) for path in below if path.is_dir())
        return cls(place, dict(work.settings), files, folders)

    @property
    def digest(self) -> str:
        """A digest of the settings and of where the shards go."""
        texts = [(name, "") for name in self.folders]
        texts += [(name, hashlib.sha256(text).hexdigest()) for name, text in sorted(self.files.items())]
        named = repr((texts, str(self.place.out), self.place.preset, str(self.place.folder)))
        return hashlib.sha256(named.encode("utf-8", "surrogateescape")).hexdigest()


_opened: dict[str, Workspace] = {}


def _workspace(parcel: Parcel) -> Workspace:
    """Return the workspace of a parcel; it stays open for the tasks that this process is given next.

    Raises:
        UpvlError: This node does not see the folder of the results.
    """
    place = parcel.place
    if place.folder.is_dir():
        os.chdir(place.folder)  # relative paths in the settings start there
    if parcel.digest not in _opened:
        if not place.out.is_dir():
            raise UpvlError(
                f"{os.uname().nodename} has no folder {place.folder / place.out}; nodes of a cluster need the same "
                "file system at the same place, or results in an object store: --out s3://BUCKET/FOLDER"
            )
        folder = Path(tempfile.mkdtemp(prefix="upvl-stages-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        for name in parcel.folders:
            (folder / name).mkdir(parents=True, exist_ok=True)
        for name, text in parcel.files.items():
            (folder / name).write_bytes(text)
        _opened.clear()
        _opened[parcel.digest] = replace(place, stages=folder).open()
    return _opened[parcel.digest]


def run_task(parcel: Parcel, job: Job, cores: int) -> Iterator[Report]:
    """Make the shards of a job; yields a report when a shard is begun, with the one before, and at the end.

    Args:
        parcel: The workspace.
        job: The drive and its stages.
        cores: Threads that a stage may use.
    """
    import ray

    os.environ[THREADS_VARIABLE] = str(cores)
    where = f"{os.uname().nodename} process {os.getpid()}"
    report: Report = [Arrived(ray.get_runtime_context().get_node_id())]
    try:
        workspace = _workspace(parcel)
    except UpvlError as error:
        yield [*report, Failed(job.stages[0], job.segment, error)]
        return
    for event in run_job(workspace, job, parcel.values, where, _ignore_tick):
        report.append(event)
        if isinstance(event, Started):
            yield report
            report = []
    yield report


def run_task_at_once(parcel: Parcel, job: Job, cores: int) -> Report:
    """Make the shards of a job, and report all at the end."""
    return [event for report in run_task(parcel, job, cores) for event in report]


def _ignore_tick() -> None:
    """Count nothing: the driver counts shards."""
