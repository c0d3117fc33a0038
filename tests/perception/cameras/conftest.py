"""Fixture for cameras that end with their test."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.perception.cameras.running_camera import RunningCamera, write_video


@pytest.fixture
def start() -> Iterator[Callable[..., RunningCamera]]:
    running: list[RunningCamera] = []

    def start_one(*source: object, **more: object) -> RunningCamera:
        running.append(RunningCamera(*source, **more))  # type: ignore[arg-type]
        return running[-1]

    yield start_one
    for camera in running:
        camera.close()


@pytest.fixture
def video(tmp_path: Path) -> Path:
    path = tmp_path / "corridor walk.mp4"
    write_video(path)
    return path
