"""``caris-desktop track``: people in a recorded video, tracked as in the console, at full speed."""

import argparse
import json
import os
import sys
import time
from pathlib import Path

from caris_desktop.app.arguments import add_tracker
from caris_desktop.domain.file_replacement import no_room, replace_file
from caris_desktop.domain.plugins import PluginError
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.perception.inference_messages import DetectionRequest, default_threads
from caris_desktop.perception.perceiver import open_perceiver
from caris_desktop.perception.recorded_video import VideoFile, VideoFileError
from caris_desktop.perception.tracker import TrackedBox
from caris_desktop.perception.weights import WeightsError
from caris_desktop.recording.terminal import ProgressLine, reporting


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("video", metavar="VIDEO", type=Path, help="a recorded video")
    parser.add_argument(
        "--out", metavar="RESULT.txt", type=Path, required=True, help="output file for the MOTChallenge rows"
    )
    parser.add_argument("--model", metavar="FILE", type=Path, help="detector (default: the same as the console)")
    add_tracker(parser)
    parser.add_argument(
        "--no-looks", action="store_true", help="distinguish people by their movement only, not by their appearance"
    )
    parser.add_argument(
        "--threads",
        metavar="N",
        type=int,
        default=default_threads(),
        help="number of threads (default: the same as the console)",
    )


class _WrongError(Exception):
    """Failure that is printed."""


@reporting(_WrongError, VideoFileError, cancelled="Stopped; nothing was written.")
def run(arguments: argparse.Namespace) -> int:
    """Print one JSON object on standard output; exit status 1 with a sentence on standard error after a failure."""
    try:
        _check(arguments.out, arguments.video, arguments.threads)
        print(json.dumps(_track(arguments)))
    except PluginError as error:
        print(f"The plug-in {error.plugin.name} ({error.plugin.package}) failed: {error}.", file=sys.stderr)
        return 1
    except WeightsError as error:
        print(f"{error}. {error.advice}.", file=sys.stderr)
        return 1
    return 0


def _check(path: Path, video: Path, threads: int) -> None:
    """Check the arguments before the work, so that no result is lost."""
    if threads < 1:
        raise _WrongError("--threads must be at least 1.")
    folder = path.absolute().parent
    if path.is_dir():
        raise _WrongError(f"The result {path} is a folder: specify a file in it.")
    if not folder.is_dir():
        raise _WrongError(f"The result cannot be written: the folder {folder} does not exist.")
    if not os.access(folder, os.W_OK):
        raise _WrongError(f"The result cannot be written: {folder} is not writable.")
    if path.exists() and video.exists() and path.samefile(video):
        raise _WrongError("The result would overwrite the video: choose another --out.")


def _track(arguments: argparse.Namespace) -> dict[str, object]:
    with VideoFile(arguments.video) as video, ProgressLine() as line:
        began_s = time.perf_counter()
        perceiver = open_perceiver(
            arguments.model,
            tracker=arguments.tracker,
            threads=arguments.threads,
            recognise_appearance=not arguments.no_looks,
        )
        if perceiver.trouble:
            print(perceiver.trouble, file=sys.stderr)
        loaded_s = time.perf_counter()
        rows: list[str] = []
        people: set[int] = set()
        frames, detector_s, tracker_s = 0, 0.0, 0.0
        for frames, (stamp_s, image_bgr) in enumerate(video.pictures(), start=1):
            fps = frames / max(1e-9, time.perf_counter() - loaded_s)
            line.show(min(1.0, frames / max(frames, video.pictures_about)), f"{frames} frames, {fps:.1f} per second")
            height_px, width_px = image_bgr.shape[:2]
            number = frames + video.torn
            ref = FrameRef(round(stamp_s * 1e9), None, "video", "", 0, number, width_px, height_px)
            perceived = perceiver.perceive(image_bgr, DetectionRequest(ref))
            rows += [mot_row(number, box) for box in perceived.boxes]
            people |= {box.track for box in perceived.boxes}
            detector_s, tracker_s = detector_s + perceived.detector_s, tracker_s + perceived.tracker_s
        seconds = time.perf_counter() - loaded_s
        if video.torn:
            print(f"Damaged frames in {arguments.video.name}, skipped: {video.torn}.", file=sys.stderr)
    _write(arguments.out, rows)
    return {
        "frames": frames,
        "seconds": round(seconds, 3),
        "fps": round(frames / max(1e-9, seconds), 1),
        "people": len(people),
        "detector_ms": round(1e3 * detector_s / frames, 2),
        "tracker_ms": round(1e3 * tracker_s / frames, 2),
        "load_s": round(loaded_s - began_s, 2),
        "model": perceiver.label,
        "looks": perceiver.appearance_model,
        "tracker": arguments.tracker,
        "plugins": {each.title: each.package for each in perceiver.plugins},
    }


def mot_row(frame: int, box: TrackedBox) -> str:
    """Line of a MOTChallenge result; frames count from 1."""
    place = f"{box.left_px:.2f},{box.top_px:.2f},{box.width_px:.2f},{box.height_px:.2f}"
    return f"{frame},{box.track},{place},{box.confidence:.4f},-1,-1,-1\n"


def _write(path: Path, rows: list[str]) -> None:
    try:
        replace_file(path, (row.encode("ascii") for row in rows), durable=False)
    except OSError as error:
        reason = "the disk is full" if no_room(error) else error.strerror or str(error)
        raise _WrongError(f"The result {path} could not be written: {reason}.") from error
