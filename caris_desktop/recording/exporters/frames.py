"""Training data export: driving for LeRobot, images with person boxes (YOLO, MOT), and dialogue turns."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.free_names import free_name
from caris_desktop.domain.media_checks import jpeg_of
from caris_desktop.domain.sensing import People, PersonBox
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.csv_cells import CsvStyle
from caris_desktop.recording.exporters import lerobot
from caris_desktop.recording.exporters.dialogue import TURNS_BEFORE, write_dialogue
from caris_desktop.recording.exporters.exported_pictures import Pace, camera_file_name, picture_of
from caris_desktop.recording.exporters.templates import write_page
from caris_desktop.recording.replay.video_reader import VideoReader
from caris_desktop.recording.session.robot_clock_mapping import clock_summary
from caris_desktop.recording.session.session_header import SessionClock
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session_export import ExportContext, attempt
from caris_desktop.recording.studies.study_index import without_copies

YOLO_HZ, MOT_HZ = 2.0, 5.0
"""Images per second of each camera at most."""
_JPEG_QUALITY = 92
_TRAIN_SHARE = 0.8
_PICTURES_SHARE, _DRIVING_SHARE = 0.4, 0.55
_DATASET_SHARE = 0.95
_BOX_COLUMNS = (
    "image", "camera", "session_s", "utc", "stamp_ns", "frame_sequence", "box", "track", "person_id", "confidence",
    "left_px", "top_px", "width_px", "height_px",
)  # fmt: skip


class _Box(Value):
    """Box in pixels of the image, from the upper left corner, clipped to it."""

    left: float
    top: float
    width: float
    height: float
    person: PersonBox


class _Image(Value):
    """Written image with its detections."""

    path: Path
    width_px: int
    height_px: int
    people: People
    boxes: tuple[_Box, ...]


def write_frames(session: Session, out: Path, context: ExportContext) -> list[Path]:
    """Fill the empty folder ``out``. Raises OSError, SessionError."""
    yolo, mot, missing = _write_images(session, out, lambda share: context.progress(_PICTURES_SHARE * share))
    paths = _write_yolo(out / "yolo", yolo, session.clock, context.csv)
    for sequence, images in mot.items():
        paths += _write_sequence(sequence, images, session.clock, context.csv)
    driving = lerobot.write_lerobot(
        [session], out / "lerobot", lambda share: context.progress(_PICTURES_SHARE + _DRIVING_SHARE * share)
    )
    turns_path = out / "dialogue" / "turns.jsonl"
    turns_path.parent.mkdir()
    turns = write_dialogue(session, turns_path)
    readme = write_page(
        out / "README.md", "training.md.j2", session=session, robot_clock=clock_summary(session), yolo=yolo,
        yolo_hz=YOLO_HZ, mot=mot, mot_hz=MOT_HZ, missing=missing, driving=driving, lerobot=lerobot, turns=turns,
        turns_before=TURNS_BEFORE,
    )  # fmt: skip
    return [readme, *paths, *driving.paths, turns_path]


def write_dataset_of_study(sessions: Sequence[Session], out: Path, context: ExportContext) -> list[Path]:
    """Fill the empty folder ``out`` with one dataset of all sessions, and their dialogue turns.

    Raises OSError, SessionError.
    """
    sessions = without_copies(sessions, context.notify)
    driving = lerobot.write_lerobot(
        sessions, out / "dataset", lambda share: context.progress(_DATASET_SHARE * share), context.warn
    )
    path = out / "dialogue" / "turns.jsonl"
    path.parent.mkdir()
    turns = 0
    with path.open("wb") as whole:
        for session in sessions:
            part = path.with_name(f"{session.folder.name}.part")
            if attempt(session, partial(write_dialogue, path=part), context.warn):
                lines = part.read_bytes()
                turns += lines.count(b"\n")
                whole.write(lines)
            part.unlink(missing_ok=True)
    readme = write_page(
        out / "README.md", "training_study.md.j2", sessions=sessions, driving=driving, lerobot=lerobot, turns=turns,
        turns_before=TURNS_BEFORE,
    )  # fmt: skip
    return [readme, *driving.paths, path]


def _write_images(
    session: Session, out: Path, progress: Callable[[float], None]
) -> tuple[list[_Image], dict[Path, list[_Image]], int]:
    """Write images; return those for YOLO, those of each MOT sequence, and the number of detections without a frame."""
    train_until_ns = session.started_ns + round(_TRAIN_SHARE * (session.ended_ns - session.started_ns))
    span_ns = max(1, session.ended_ns - session.started_ns)
    yolo_pace, mot_pace = Pace(YOLO_HZ), Pace(MOT_HZ)
    yolo: list[_Image] = []
    sequences: dict[tuple[str, int, int], Path] = {}
    mot: dict[Path, list[_Image]] = {}
    missing = 0
    for part in ("images/train", "images/val", "labels/train", "labels/val"):
        (out / "yolo" / part).mkdir(parents=True)
    (out / "mot").mkdir()
    with VideoReader(session) as videos:
        for number, (_, people) in enumerate(session.values("people")):
            if not number % 20:
                progress(min(1.0, max(0.0, (people.stamp_ns - session.started_ns) / span_ns)))
            camera, stamp_ns = people.camera, people.stamp_ns
            due = [pace for pace in (yolo_pace, mot_pace) if pace.is_due(camera, stamp_ns)]
            if not due:
                continue
            picture = picture_of(videos, camera, stamp_ns)
            if picture is None:
                missing += 1
                continue
            height_px, width_px = picture.image_bgr.shape[:2]
            boxes = _detections(people, picture.image_bgr)
            jpeg = jpeg_of(picture.image_bgr, quality=_JPEG_QUALITY)
            for pace in due:
                pace.take(camera, stamp_ns)
                if pace is yolo_pace:
                    part, images = "train" if stamp_ns < train_until_ns else "val", yolo
                    path = out / "yolo" / "images" / part / f"{camera_file_name(camera)}-{len(yolo) + 1:06d}.jpg"
                else:
                    key = camera, width_px, height_px
                    name = free_name(camera_file_name(camera), "-machine-made", lambda name: out / "mot" / name in mot)
                    folder = sequences.setdefault(key, out / "mot" / name)
                    images = mot.setdefault(folder, [])
                    path = folder / "img1" / f"{len(images) + 1:06d}.jpg"
                    path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(jpeg)
                images.append(_Image(path, width_px, height_px, people, boxes))
    return yolo, mot, missing


def _detections(people: People, image_bgr: NDArray[np.uint8]) -> tuple[_Box, ...]:
    """Boxes in pixels of the image, clipped to its borders; those outside are left out."""
    height, width = image_bgr.shape[:2]
    # Encoders drop an odd last row or column; a larger difference means a different resolution.
    same = abs(people.frame_width_px - width) <= 1 and abs(people.frame_height_px - height) <= 1
    across = 1.0 if same else width / max(1, people.frame_width_px)
    down = 1.0 if same else height / max(1, people.frame_height_px)
    found = []
    for person in people.boxes:
        left, top = max(0.0, person.left_px * across), max(0.0, person.top_px * down)
        right = min(float(width), (person.left_px + person.width_px) * across)
        bottom = min(float(height), (person.top_px + person.height_px) * down)
        if right > left and bottom > top:
            found.append(_Box(left, top, right - left, bottom - top, person))
    return tuple(found)


def _write_yolo(folder: Path, images: list[_Image], clock: SessionClock, style: CsvStyle) -> list[Path]:
    """Write labels, ``data.yaml``, and ``boxes.csv`` with columns that labels lack; return all files."""
    rows: list[tuple[Any, ...]] = []
    labels = []
    for image in images:
        width, height = image.width_px, image.height_px
        lines = [
            f"0 {(box.left + box.width / 2) / width:.6f} {(box.top + box.height / 2) / height:.6f}"
            f" {box.width / width:.6f} {box.height / height:.6f}\n"
            for box in image.boxes
        ]
        labels.append(folder / "labels" / image.path.parent.name / f"{image.path.stem}.txt")
        labels[-1].write_text("".join(lines), encoding="utf-8")
        people, stamp_ns = image.people, image.people.stamp_ns
        moment = (
            image.path.relative_to(folder).as_posix(), people.camera, round(clock.session_s(stamp_ns), 6),
            clock.utc(stamp_ns), stamp_ns, people.frame_sequence,
        )  # fmt: skip
        for number, box in enumerate(image.boxes, start=1):
            place = [round(value, 2) for value in (box.left, box.top, box.width, box.height)]
            person = box.person
            rows.append((*moment, number, person.track, person.person_id, round(person.confidence, 4), *place))
    data = folder / "data.yaml"
    data.write_text(
        "# Images of one session. The boxes come from a detector and tracker, and have not been corrected.\n"
        "# val is the last fifth of the session. For meaningful results, validate on other sessions.\n"
        "train: images/train\nval: images/val\nnames:\n  0: person\n",
        encoding="utf-8",
    )
    boxes = _write_csv(folder / "boxes.csv", style, _BOX_COLUMNS, rows)
    return [data, boxes, *labels, *(image.path for image in images)]


def _write_sequence(folder: Path, images: list[_Image], clock: SessionClock, style: CsvStyle) -> list[Path]:
    """Write a MOTChallenge sequence with the tracks of the recording's own tracker; return all files."""
    ids: dict[int, int] = {}
    person_ids: dict[int, set[str]] = {}
    det, gt = [], []
    for frame, image in enumerate(images, start=1):
        for box in image.boxes:
            # Frames, identities and pixels count from 1 there.
            place = f"{box.left + 1:.2f},{box.top + 1:.2f},{box.width:.2f},{box.height:.2f}"
            identity = ids.setdefault(box.person.track, len(ids) + 1)
            person_ids.setdefault(identity, set()).add(box.person.person_id)
            det.append(f"{frame},-1,{place},{box.person.confidence:.4f},-1,-1,-1\n")
            gt.append(f"{frame},{identity},{place},1,1,1\n")
    stamps_ns = [image.people.stamp_ns for image in images]
    span_s = (stamps_ns[-1] - stamps_ns[0]) / 1e9
    rate_hz = (len(images) - 1) / span_s if span_s else 0.0
    texts = {
        "seqinfo.ini": (
            f"[Sequence]\nname={folder.name}\nimDir=img1\nframeRate={max(1, round(rate_hz))}\nseqLength={len(images)}\n"
            f"imWidth={images[0].width_px}\nimHeight={images[0].height_px}\nimExt=.jpg\n"
        ),
        "det/det.txt": "".join(det),
        "gt/gt.txt": "".join(gt),
        "gt/MACHINE-MADE.txt": (
            "gt.txt contains the tracks of the recording's own tracker. They have not been corrected, so they are not "
            "ground truth\nyet. The file has this name because tools for the MOT format look for it.\n"
        ),
    }
    for name, text in texts.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    times = [
        (number, round(clock.session_s(stamp_ns), 6), clock.utc(stamp_ns), stamp_ns)
        for number, stamp_ns in enumerate(stamps_ns, start=1)
    ]
    tracks = [(identity, track, " ".join(sorted(person_ids[identity]))) for track, identity in ids.items()]
    return [
        *(folder / name for name in texts),
        _write_csv(folder / "frames.csv", style, ("frame", "session_s", "utc", "stamp_ns"), times),
        _write_csv(folder / "tracks.csv", style, ("id", "track", "person_ids"), tracks),
        *(image.path for image in images),
    ]


def _write_csv(path: Path, style: CsvStyle, columns: tuple[str, ...], rows: Iterable[tuple[Any, ...]]) -> Path:
    with path.open("w", encoding=style.encoding, errors="replace", newline="") as file:
        writer = style.writer(file)
        writer.writerow(columns)
        writer.writerows(rows)
    return path
