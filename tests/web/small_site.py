"""A small workspace of known objects in a street that has pictures, and clients of its site."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import uvicorn
from starlette.testclient import TestClient

from query.stored import Thing
from query.stored import workspace as stored_workspace
from upvl_cli.pipeline.tables import write
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.stages.rows import LabelRow
from upvl_cli.web.guard import Access
from upvl_cli.web.site import Site

OWN_MACHINE = Access(frozenset({"127.0.0.1", "localhost", "[::1]"}))
HOME = "http://127.0.0.1:8700"
FRAMES = tuple(range(6))

STREET = [
    Thing({"bus": 18, "car": 2}, x_m=14, y_m=1, speed_mps=5, track=7, frames=FRAMES, look="bus"),
    Thing({"car": 9}, x_m=20, y_m=-4, speed_mps=3, track=8, frames=FRAMES, score=0.9),
    Thing({"car": 5, "bus": 5}, x_m=26, y_m=6, track=9, frames=FRAMES[:2], score=0.5),
    Thing({"pedestrian": 6}, x_m=14, y_m=4, track=10, frames=FRAMES[2:]),
    Thing({"pedestrian": 6}, x_m=30, y_m=20, track=11, frames=FRAMES),
    Thing({}, x_m=40, track=-1),
]


def workspace(folder: Path, frames: int = len(FRAMES)) -> Workspace:
    """A drive with pictures, and one whose raw data are gone."""
    return stored_workspace(
        folder, {"street-0": STREET, "gone": [Thing({"bus": 8}, x_m=25, track=7)]}, frames
    )


def client(made: Workspace, access: Access = OWN_MACHINE, base_url: str = HOME) -> TestClient:
    """A client without a socket; errors inside are answers, as on a server."""
    return TestClient(Site(made).application(access), base_url, raise_server_exceptions=False)


@dataclass
class Running:
    """A real server: where it is."""

    port: int

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.port}"


@contextmanager
def running(made: Workspace, access: Access = OWN_MACHINE) -> Iterator[Running]:
    """A real server on a free port, as `upvl serve` configures it."""
    listening = socket.create_server(("127.0.0.1", 0))
    config = uvicorn.Config(
        Site(made).application(access), log_level="critical", lifespan="off", ws="none", http="h11",
        server_header=False, proxy_headers=False, h11_max_incomplete_event_size=2**14,
    )  # fmt: skip
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, daemon=True)
    thread.start()
    while not server.started:
        time.sleep(0.01)
    try:
        yield Running(listening.getsockname()[1])
    finally:
        server.should_exit = True
        thread.join(10)
        listening.close()


def label(
    made: Workspace, segment: str, things: list[Thing], names: list[tuple[str, str]], frames: int
) -> None:
    """Write labels without features: class and word of each thing."""
    rows = []
    for frame in range(frames):
        here = [(thing, name) for thing, name in zip(things, names, strict=True) if frame in thing.frames]
        n = len(here)
        rows.append(
            LabelRow(
                segment, frame, time_ns=10**9 + frame * 10**8,
                center_m=np.array([[thing.x_m, thing.y_m, 0] for thing, _ in here]).reshape(-1, 3),
                size_lwh_m=np.tile([4, 2, 1.5], (n, 1)), heading_rad=np.zeros(n),
                velocity_mps=np.array([[thing.speed_mps, 0, 0] for thing, _ in here]).reshape(-1, 3),
                num_points=np.ones(n), score=np.array([thing.score for thing, _ in here]),
                track_id=np.array([thing.track for thing, _ in here], dtype=np.int64),
                background_share=np.zeros(n), num_frames_seen=np.ones(n), objectness=np.ones(n),
                sides_seen=np.ones(n), residual_m=np.zeros(n),
                class_name=np.array([name[0] for _, name in here], dtype=object),
                word=np.array([name[1] for _, name in here], dtype=object),
                class_share=np.ones(n), is_moving=np.zeros(n, bool), num_looks=np.zeros(n),
                look_word=np.full((n, 3), "", dtype=object), look_share=np.zeros((n, 3)),
                words_agree=np.ones(n, bool), iou_2d=np.zeros(n),
                box_word=np.full(n, "", dtype=object), box_share=np.zeros(n),
            )
        )  # fmt: skip
    write(made.shard("labels", segment), LabelRow, rows, stamp="{}", counts={})
