"""``caris-desktop perceive-again``: people in recordings detected by another model, as an additional layer."""

import argparse
import json
import re
import shutil
import sys
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import field
from functools import partial
from pathlib import Path

from caris_desktop import __version__
from caris_desktop.app.arguments import add_tracker
from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.events import RobotChosen
from caris_desktop.domain.file_replacement import no_room, replace_file
from caris_desktop.domain.foreign_text import parse_json
from caris_desktop.domain.plugins import PluginError
from caris_desktop.domain.sensing import FrameRef, HeadState, Odometry, People
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.domain.value_class import dataclass
from caris_desktop.live.study_jobs import JobError, add_session_arguments, run_over_sessions
from caris_desktop.perception.camera_schedule import CameraRotation
from caris_desktop.perception.inference import person_box
from caris_desktop.perception.inference_messages import USUAL_FOCAL_PER_WIDTH, DetectionRequest
from caris_desktop.perception.offline_smoothing import looked_back
from caris_desktop.perception.perceiver import Perceiver, open_perceiver
from caris_desktop.perception.pose import Pose
from caris_desktop.perception.tracker import TrackedBox
from caris_desktop.perception.weights import WeightsError
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.recorder.event_log import EventLog
from caris_desktop.recording.replay.video_reader import RecordedFrame, VideoPicture, VideoReader
from caris_desktop.recording.session.manifest import DERIVED_FOLDER
from caris_desktop.recording.session.session_header import SessionError
from caris_desktop.recording.session.session_reader import Session, open_session
from caris_desktop.recording.session_export import Progress
from caris_desktop.recording.table_files import DELETED_BY_ERASURE
from caris_desktop.robot.profile import parse_profile
from caris_desktop.robot.profile_model import ProfileError

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,79}")
_AHEAD_NS = 500_000_000
_DECODED_AHEAD = 4


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_session_arguments(parser)
    parser.add_argument("--model", metavar="FILE", type=Path, help="detector (default: the same as the console)")
    add_tracker(parser)
    parser.add_argument(
        "--offline-quality",
        action="store_true",
        help="use later frames too: tracks of the same person are merged, and gaps of up to two seconds are filled",
    )
    parser.add_argument(
        "--name", help="name of the layer, a folder in the session's derived/ (default: named after model and tracker)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Print a JSON object per session on standard output; exit status 1 if any failed."""
    if arguments.name is not None and not _NAME.fullmatch(arguments.name):
        print("--name can only contain letters, digits, dots, dashes and underscores.", file=sys.stderr)
        return 2
    if arguments.name in DELETED_BY_ERASURE:
        print(f"--name cannot be {arguments.name}: the console uses that folder. Choose another name.", file=sys.stderr)
        return 2
    return run_over_sessions(_perceive_or_explain, arguments)


def _perceive_or_explain(arguments: argparse.Namespace, folder: Path, progress: Progress) -> dict[str, object]:
    try:
        return _perceive(folder, arguments, progress)
    except SessionError as error:
        raise JobError(str(error)) from error
    except PluginError as error:
        text = f"the plug-in {error.plugin.name} ({error.plugin.package}) failed: {error}. Nothing was saved."
        raise JobError(text) from error
    except WeightsError as error:
        raise JobError(f"{error}. {error.advice}.") from error
    except OSError as error:
        reason = "the disk is full" if no_room(error) else error.strerror or str(error)
        raise JobError(f"the layer could not be written: {reason}. Nothing was saved.") from error


@dataclass(slots=True)
class _CameraLayer:
    """Detections in the videos of one camera."""

    frames: list[RecordedFrame] = field(default_factory=list)
    sizes_px: list[tuple[int, int]] = field(default_factory=list)
    boxes: list[list[TrackedBox]] = field(default_factory=list)
    poses: list[dict[int, Pose]] = field(default_factory=list)
    """By the row of the detection, since looking back may find out that two tracks are one."""
    lost: int = 0


def _perceive(folder: Path, arguments: argparse.Namespace, progress: Progress) -> dict[str, object]:
    session = open_session(folder, repair=False)
    perceiver = open_perceiver(
        arguments.model, tracker=arguments.tracker, threads=arguments.threads, recognise_appearance=True
    )
    if perceiver.trouble:
        print(perceiver.trouble, file=sys.stderr)
    model = arguments.model.stem if arguments.model is not None else "usual"
    usual_name = f"{model}-{arguments.tracker}{'-offline' if arguments.offline_quality else ''}"
    name = arguments.name or re.sub(r"[^A-Za-z0-9._-]", "-", usual_name).lstrip(".-_")[:80] or "layer"
    target = folder / DERIVED_FOLDER / name
    settings = {
        "layer": name,
        "session": folder.name,
        "program_version": __version__,
        "model": perceiver.label,
        "looks": perceiver.appearance_model,
        "tracker": arguments.tracker,
        "plugins": {each.title: each.package for each in perceiver.plugins},
        "offline_quality": arguments.offline_quality,
    }
    if target.exists():
        about = _about(target)
        if {key: about.get(key) for key in settings} == settings:
            return about  # made by a run that was interrupted later
        raise JobError(
            f"a layer {name} with other settings already exists; choose another --name. Nothing was changed."
        )
    layers = {}
    with VideoReader(session) as videos:
        for number, camera in enumerate(videos.cameras):
            share = partial(_report_camera, progress, number, len(videos.cameras), f"{folder.name} {camera}")
            layers[camera] = _layer(session, videos, camera, perceiver, share)
    problems = list(videos.problems)
    if not any(layer.frames for layer in layers.values()):
        raise JobError(" ".join(["the session has no readable video.", *problems]))
    if arguments.offline_quality:
        for layer in layers.values():
            layer.boxes = looked_back(layer.boxes, [frame.stamp_ns / 1e9 for frame in layer.frames])
    about = {
        **settings,
        "cameras": {
            camera: {
                "pictures": len(layer.frames),
                "pictures_not_readable": layer.lost,
                "people": len({box.track for boxes in layer.boxes for box in boxes}),
            }
            for camera, layer in layers.items()
        },
        "problems": problems,
    }
    _write(session, target, layers, about)
    return about


def _about(layer: Path) -> dict[str, object]:
    try:
        about = parse_json((layer / "layer.json").read_bytes())
    except (OSError, ValueError):
        return {}
    return about if isinstance(about, dict) else {}


def _report_camera(progress: Progress, number: int, count: int, what: str, fraction: float) -> None:
    progress((number + fraction) / count, what)


def _layer(
    session: Session, videos: VideoReader, camera: str, perceiver: Perceiver, progress: Callable[[float], None]
) -> _CameraLayer:
    layer = _CameraLayer()
    count = len(videos.frame_times_ns(camera))
    model = _camera_model(session, camera)
    turns, turning = _turns(session), CameraRotation()
    waiting = next(turns, None)
    for number, picture in enumerate(_decoded_ahead(videos, camera, count)):
        if picture is None:
            layer.lost += 1
            continue
        info, image_bgr = picture.info, picture.image_bgr
        height_px, width_px = image_bgr.shape[:2]
        while waiting is not None and waiting.stamp_ns <= info.stamp_ns + _AHEAD_NS:
            turning.add(waiting)
            waiting = next(turns, None)
        ref = FrameRef(info.stamp_ns, info.robot_stamp_ns, camera, "", 0, number, width_px, height_px)
        direction = None if model is None else turning.direction(info.stamp_ns, on_head=model.on_head)
        focal = USUAL_FOCAL_PER_WIDTH if model is None else model.fx_px / model.width_px
        perceived = perceiver.perceive(image_bgr, DetectionRequest(ref, direction, focal))
        layer.boxes.append(perceived.boxes)
        layer.poses.append(
            {box.detection: perceived.poses[box.track] for box in perceived.boxes if box.track in perceived.poses}
        )
        layer.frames.append(info)
        layer.sizes_px.append((width_px, height_px))
        progress((number + 1) / count)
    return layer


def _decoded_ahead(videos: VideoReader, camera: str, count: int) -> Iterator[VideoPicture | None]:
    """All frames of a camera in their order; the next ones are decoded in a thread meanwhile."""
    with ThreadPoolExecutor(1, "decoder") as decoder:
        waiting = deque[Future[VideoPicture | None]]()
        for number in range(count):
            waiting.append(decoder.submit(videos.frame, camera, number))
            if len(waiting) > _DECODED_AHEAD:
                yield waiting.popleft().result()
        yield from (future.result() for future in waiting)


def _turns(session: Session) -> Iterator[Odometry | HeadState]:
    for _, value in session.values(BY_TYPE[Odometry].name, BY_TYPE[HeadState].name):
        yield value


def _camera_model(session: Session, camera: str) -> CameraModel | None:
    """Model of the camera on the driven robot, from its recorded profile."""
    model = None
    for _, chosen in session.values(BY_TYPE[RobotChosen].name):
        try:
            profile = parse_profile(chosen.profile, file_name=f"{chosen.name}.yaml", name=chosen.name)
        except ProfileError:
            continue
        model = next((each.model for each in profile.cameras if each.name == camera), model)
    return model


def _write(session: Session, target: Path, layers: dict[str, _CameraLayer], about: dict[str, object]) -> None:
    """Write the layer atomically."""
    part = target.with_name(f".{target.name}.unfinished")
    if part.exists():
        shutil.rmtree(part)  # left by a killed run
    part.mkdir(parents=True)
    try:
        log = EventLog(
            DiskFile(part / "people.mcap"), anchor=session.clock.anchor, metadata={"program_version": __version__}
        )
        try:
            for people in sorted(_people(layers), key=lambda each: each.stamp_ns):
                log.write(BY_TYPE[People], people, people.stamp_ns)
        finally:
            log.close()
        text = json.dumps(about, indent=2, ensure_ascii=False) + "\n"
        replace_file(part / "layer.json", text.encode(), durable=True)
        part.rename(target)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise


def _people(layers: dict[str, _CameraLayer]) -> Iterator[People]:
    for camera, layer in layers.items():
        pictures = zip(layer.frames, layer.sizes_px, layer.boxes, layer.poses, strict=True)
        for info, (width_px, height_px), boxes, poses in pictures:
            yield People(
                stamp_ns=info.stamp_ns,
                camera=camera,
                frame_sequence=info.number,
                frame_width_px=width_px,
                frame_height_px=height_px,
                boxes=tuple(person_box(box, poses.get(box.detection, Pose())) for box in boxes),
                inference_ms=0.0,
            )
