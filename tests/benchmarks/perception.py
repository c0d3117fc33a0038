"""Perception of the console compared with ultralytics, with the same images and weights, alternating within one run.

Prints one JSON object.

    python -m tests.benchmarks.perception [--video FILE] [--int8 FILE] [--looks FILE] [--threads N] [--px 640] ...

Two comparisons, each block of images first by one, then by the other, so that a busy machine slows both alike. No
runtime spins while it waits, and all use as many threads.

- ``untrained``: YOLOv8n's architecture with random weights, whose time is that of trained ones, against
  ``YOLO(...).track(...)``. It finds nobody, so trackers cost nothing. Our export to ONNX runs on each installed
  runtime; the fastest counts.
- ``int8``: the quantised network with detection and tracking; also with appearance embeddings, and their cost. The
  time of a whole image is compared with the bare detector.
"""

import argparse
import json
import os
import statistics
import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Before any runtime is loaded: waiting threads sleep.
os.environ |= {"OMP_WAIT_POLICY": "PASSIVE", "KMP_BLOCKTIME": "0"}

from caris_desktop.domain.sensing import FrameRef
from caris_desktop.perception.appearance_embedding import AppearanceModel
from caris_desktop.perception.backends.network import NetworkDetector
from caris_desktop.perception.backends.runtime_selection import Chosen, open_detector
from caris_desktop.perception.backends.runtimes import OpenvinoNetwork, openvino_installed
from caris_desktop.perception.backends.ultralytics_runtime import export_onnx, prepare_ultralytics
from caris_desktop.perception.detector import Detector, person_classes
from caris_desktop.perception.inference_messages import LEAST_CONFIDENCE, DetectionRequest, default_threads
from caris_desktop.perception.perceiver import Perceiver
from caris_desktop.perception.recorded_video import VideoFile
from caris_desktop.perception.tracker import PersonTracker
from caris_desktop.perception.weights import Weights
from tests.perception.shared_data import INT8_WEIGHTS, OSNET_WEIGHTS, TUD_CAMPUS_VIDEO

Image = NDArray[np.uint8]
_BLOCK = 8


@dataclass(slots=True)
class Way:
    """One pipeline. ``step`` processes the next image and returns the times of detector and tracker."""

    name: str
    step: Callable[[int, float, Image], tuple[float, float]]
    detector_ms: list[float] = field(default_factory=list)
    tracker_ms: list[float] = field(default_factory=list)

    def take(self, number: int, stamp_s: float, image_bgr: Image) -> None:
        detector_s, tracker_s = self.step(number, stamp_s, image_bgr)
        self.detector_ms.append(1e3 * detector_s)
        self.tracker_ms.append(1e3 * tracker_s)

    @property
    def total_ms(self) -> float:
        return statistics.median(a + b for a, b in zip(self.detector_ms, self.tracker_ms, strict=True))

    def report(self) -> dict[str, float]:
        return {
            "detector_ms": round(statistics.median(self.detector_ms), 2),
            "tracker_ms": round(statistics.median(self.tracker_ms), 2),
            "tracker_mean_ms": round(statistics.mean(self.tracker_ms), 2),
            "total_ms": round(self.total_ms, 2),
        }


class _CountedLooks(AppearanceModel):
    """Counts the embedded people."""

    looked_at = 0

    def look(self, image_bgr: Image, corners_px: Any) -> NDArray[np.float64]:
        self.looked_at += len(corners_px)
        return super().look(image_bgr, corners_px)


def ours(name: str, detector: Detector, weights: Weights, looks: AppearanceModel | None = None) -> Way:
    """Pipeline of the console."""
    people = person_classes(detector, weights)
    perceiver = Perceiver(
        Chosen(detector, people, None), PersonTracker(people, tracker="own", appearance=looks), appearance_model=""
    )

    def step(number: int, stamp_s: float, image_bgr: Image) -> tuple[float, float]:
        height_px, width_px = image_bgr.shape[:2]
        began_s = time.perf_counter()
        ref = FrameRef(round(stamp_s * 1e9), None, "video", "", 0, number, width_px, height_px)
        perceived = perceiver.perceive(image_bgr, DetectionRequest(ref))
        whole_s = time.perf_counter() - began_s
        return perceived.detector_s, whole_s - perceived.detector_s

    return Way(name, step)


def theirs(name: str, path: Path, px: int, tracker: str) -> Way:
    """Pipeline of ultralytics as in its documentation, for people only."""
    from ultralytics import YOLO

    model = YOLO(str(path), task="detect")

    def step(_number: int, _stamp_s: float, image_bgr: Image) -> tuple[float, float]:
        began_s = time.perf_counter()
        result = model.track(
            image_bgr,
            persist=True,
            imgsz=px,
            conf=LEAST_CONFIDENCE,
            classes=[0],
            tracker=f"{tracker}.yaml",
            device="cpu",
            verbose=False,
        )[0]
        whole_s = time.perf_counter() - began_s
        detector_s = sum(result.speed.values()) / 1e3
        return detector_s, whole_s - detector_s

    return Way(name, step)


def in_turn(ways: Iterable[Way], pictures: list[tuple[float, Image]]) -> None:
    """Run each block of images through each pipeline, after an uncounted first image."""
    ways = list(ways)
    for way in ways:
        way.step(0, -1.0, np.full_like(pictures[0][1], 114))
    for first in range(0, len(pictures), _BLOCK):
        for way in ways:
            for number in range(first, min(first + _BLOCK, len(pictures))):
                way.take(number + 1, *pictures[number])


def untrained(folder: Path, pictures: list[tuple[float, Image]], threads: int, px: int) -> dict[str, object]:
    from ultralytics import YOLO

    path = folder / "untrained-yolov8n.pt"
    model = YOLO("yolov8n.yaml", task="detect")
    model.model.names = {0: "person"} | {number: f"thing {number}" for number in range(1, 80)}
    model.save(str(path))
    exported = folder / "untrained-yolov8n.onnx"
    export_onnx(Weights(path, path.name, px), exported, threads=threads)
    weights = Weights(exported, exported.name, px)
    detectors = {"onnxruntime": open_detector(weights, confidence=LEAST_CONFIDENCE, threads=threads)}
    if openvino_installed():
        network = OpenvinoNetwork(exported, threads=threads)
        detectors["OpenVINO"] = NetworkDetector(network, weights, confidence=LEAST_CONFIDENCE)
    own = [ours(name, detector, weights) for name, detector in detectors.items()]
    library = [theirs("bytetrack", path, px, "bytetrack"), theirs("botsort", path, px, "botsort")]
    in_turn([*own, *library], pictures)
    fastest = min(own, key=lambda way: way.total_ms)
    return {
        "px": px,
        "fastest": fastest.name,
        **{way.name: way.report() for way in (*own, *library)},
        "times_as_fast": {way.name: round(way.total_ms / fastest.total_ms, 2) for way in library},
    }


def int8(weights: Path, looks: Path, pictures: list[tuple[float, Image]], threads: int) -> dict[str, object]:
    found = Weights(weights, weights.name, 320)
    detector = open_detector(found, confidence=LEAST_CONFIDENCE, threads=threads)
    own = ours("ours", detector, found)
    ways = [own, theirs("bytetrack", weights, 320, "bytetrack"), theirs("botsort", weights, 320, "botsort")]
    counted = _CountedLooks(looks, threads=threads) if looks.is_file() else None
    if counted is not None:
        ways.append(ours("ours_with_looks", detector, found, looks=counted))
    in_turn(ways, pictures)
    bare_ms = statistics.median(own.detector_ms)
    report: dict[str, object] = {
        "model": detector.label,
        **{way.name: way.report() for way in ways},
        "times_as_fast": {way.name: round(way.total_ms / own.total_ms, 2) for way in ways[1:3]},
        "whole_to_bare_detector": round(own.total_ms / bare_ms, 2),
    }
    if counted is not None:
        with_looks = ways[-1]
        added_ms = statistics.mean(with_looks.tracker_ms) - statistics.mean(own.tracker_ms)
        report |= {
            "whole_to_bare_detector_with_looks": round(with_looks.total_ms / bare_ms, 2),
            "looks_add_ms_a_picture": round(added_ms, 2),
            "people_looked_at_a_picture": round(counted.looked_at / len(pictures), 2),
        }
    return report


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--video", type=Path, default=TUD_CAMPUS_VIDEO)
    parser.add_argument("--pictures", type=int, default=10_000, help="at most so many of the video")
    parser.add_argument("--int8", type=Path, default=INT8_WEIGHTS)
    parser.add_argument("--looks", type=Path, default=OSNET_WEIGHTS, help="a re-identification network")
    parser.add_argument("--threads", type=int, default=default_threads())
    parser.add_argument("--px", type=int, default=640, help="input of the untrained network")
    arguments = parser.parse_args()
    prepare_ultralytics(threads=arguments.threads)
    with VideoFile(arguments.video) as video:
        pictures = list(video.pictures())[: arguments.pictures]
    report: dict[str, object] = {"pictures": len(pictures), "threads": arguments.threads}
    with tempfile.TemporaryDirectory() as folder:
        report["untrained"] = untrained(Path(folder), pictures, arguments.threads, arguments.px)
    if arguments.int8.is_file():
        report["int8"] = int8(arguments.int8, arguments.looks, pictures, arguments.threads)
    print(json.dumps(report))


if __name__ == "__main__":
    main()
