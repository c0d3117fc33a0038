"""Training data export: images with person boxes (YOLO, MOT), driving episodes and dialogue turns."""

from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import field
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.picture_checks import jpeg_of
from caris_desktop.domain.sensing import People, PersonBox
from caris_desktop.domain.value_class import dataclass
from caris_desktop.recording.csv_cells import CsvStyle
from caris_desktop.recording.exporters.episodes import PICTURE_WIDTH_PX, Written, write_dialogue, write_driving
from caris_desktop.recording.exporters.exported_pictures import Pace, camera_file_name, picture_of
from caris_desktop.recording.replay.video_reader import VideoReader
from caris_desktop.recording.session.robot_clock_mapping import robot_clock
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session_export import ExportContext

YOLO_HZ, MOT_HZ = 2.0, 5.0
_JPEG_QUALITY = 92
_TRAIN_SHARE = 0.8
_PICTURES_SHARE, _DRIVING_SHARE = 0.6, 0.35
_BOX_COLUMNS = (
    "image", "camera", "session_s", "utc", "stamp_ns", "frame_sequence", "box", "track", "person_id", "confidence",
    "left_px", "top_px", "width_px", "height_px",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Box:
    """Box in pixels of the image, from the upper left corner, clipped to it."""

    left: float
    top: float
    width: float
    height: float
    person: PersonBox


def write_frames(
    session: Session,
    out: Path,
    context: ExportContext,
    *,
    yolo_hz: float | None = YOLO_HZ,
    mot_hz: float | None = MOT_HZ,
) -> list[Path]:
    """Fill the folder ``out``. The rates limit images per camera; None: every frame with detections.

    Raises OSError, SessionError.
    """
    yolo = _Yolo(session, out / "yolo", yolo_hz, context.csv)
    mot = _Mot(session, out / "mot", mot_hz, context.csv)
    missing = _write_pictures(session, yolo, mot, lambda share: context.progress(_PICTURES_SHARE * share))
    driving = write_driving(
        session, out / "driving", lambda share: context.progress(_PICTURES_SHARE + _DRIVING_SHARE * share)
    )
    dialogue = write_dialogue(session, out / "dialogue")
    readme = out / "README.md"
    readme.write_text(
        _readme(session, yolo, mot, driving=driving, dialogue=dialogue, missing=missing),
        encoding="utf-8",
        errors="replace",
    )
    return [readme, *yolo.paths, *mot.paths, *driving.paths, *dialogue.paths]


def _write_pictures(session: Session, yolo: "_Yolo", mot: "_Mot", progress: Callable[[float], None]) -> int:
    """Write images; return the number of detections without a frame."""
    missing = 0
    span_ns = max(1, session.ended_ns - session.started_ns)
    with VideoReader(session) as videos, yolo, mot:
        for number, (_, people) in enumerate(session.values("people")):
            if not number % 20:
                progress(min(1.0, max(0.0, (people.stamp_ns - session.started_ns) / span_ns)))
            due = [one for one in (yolo, mot) if one.pace.is_due(people.camera, people.stamp_ns)]
            if not due:
                continue
            picture = picture_of(videos, people.camera, people.stamp_ns)
            if picture is None:
                missing += 1
                continue
            boxes = _detections(people, picture.image_bgr)
            jpeg = jpeg_of(picture.image_bgr, quality=_JPEG_QUALITY)
            for one in due:
                one.pace.take(people.camera, people.stamp_ns)
                one.add(people, boxes, picture.image_bgr).write_bytes(jpeg)
    return missing


def _detections(people: People, image_bgr: NDArray[np.uint8]) -> list[_Box]:
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
    return found


class _Yolo:
    """YOLO dataset: ``data.yaml``, ``images/``, ``labels/``, and ``boxes.csv`` with columns that YOLO labels lack."""

    def __init__(self, session: Session, folder: Path, most_hz: float | None, style: CsvStyle) -> None:
        self._csv = style
        self.pace = Pace(most_hz)
        self.most_hz = most_hz
        self.images: Counter[str] = Counter()
        self.boxes = 0
        self._session = session
        self._folder = folder
        self._train_until_ns = session.started_ns + round(_TRAIN_SHARE * (session.ended_ns - session.started_ns))
        for part in ("train", "val"):
            (folder / "images" / part).mkdir(parents=True)
            (folder / "labels" / part).mkdir(parents=True)
        self.paths = [folder / "data.yaml", folder / "boxes.csv"]
        self.paths[0].write_text(
            "# Images of one session. The boxes come from a detector and tracker, and have not been corrected.\n"
            "# val is the last fifth of the session. For meaningful results, validate on other sessions.\n"
            "train: images/train\nval: images/val\nnames:\n  0: person\n",
            encoding="utf-8",
        )
        self._files = ExitStack()
        self._rows: Any = None

    def __enter__(self) -> "_Yolo":
        file = self._files.enter_context(
            self.paths[1].open("w", encoding=self._csv.encoding, errors="replace", newline="")
        )
        self._rows = self._csv.writer(file)
        self._rows.writerow(_BOX_COLUMNS)
        return self

    def __exit__(self, *_: object) -> None:
        self._files.close()

    def add(self, people: People, boxes: list[_Box], image_bgr: NDArray[np.uint8]) -> Path:
        """Write the labels; return the path for the image."""
        part = "train" if people.stamp_ns < self._train_until_ns else "val"
        self.images[part] += 1
        name = f"{camera_file_name(people.camera)}-{self.images.total():06d}"
        height, width = image_bgr.shape[:2]
        lines = [
            f"0 {(box.left + box.width / 2) / width:.6f} {(box.top + box.height / 2) / height:.6f}"
            f" {box.width / width:.6f} {box.height / height:.6f}\n"
            for box in boxes
        ]
        label = self._folder / "labels" / part / f"{name}.txt"
        label.write_text("".join(lines), encoding="utf-8")
        image = self._folder / "images" / part / f"{name}.jpg"
        self.paths += [image, label]
        self._notify(people, boxes, image)
        self.boxes += len(boxes)
        return image

    def _notify(self, people: People, boxes: list[_Box], image: Path) -> None:
        clock = self._session.clock
        moment = [
            image.relative_to(self._folder).as_posix(),
            people.camera,
            round(clock.session_s(people.stamp_ns), 6),
            clock.utc(people.stamp_ns),
            people.stamp_ns,
            people.frame_sequence,
        ]
        for number, box in enumerate(boxes, start=1):
            place = [round(value, 2) for value in (box.left, box.top, box.width, box.height)]
            person = box.person
            self._rows.writerow([*moment, number, person.track, person.person_id, round(person.confidence, 4), *place])


@dataclass(slots=True)
class _Sequence:
    """MOT sequence in progress."""

    folder: Path
    width_px: int
    height_px: int
    det: IO[str]
    gt: IO[str]
    stamps_ns: list[int] = field(default_factory=list)
    ids: dict[int, int] = field(default_factory=dict)
    people: dict[int, set[str]] = field(default_factory=dict)


class _Mot:
    """MOTChallenge sequences, with the tracks of the recording's own tracker."""

    def __init__(self, session: Session, folder: Path, most_hz: float | None, style: CsvStyle) -> None:
        self._csv = style
        self.pace = Pace(most_hz)
        self.most_hz = most_hz
        self.paths: list[Path] = []
        self.sequences: dict[tuple[str, int, int], _Sequence] = {}
        self._session = session
        self._folder = folder
        self._files = ExitStack()
        folder.mkdir()

    def __enter__(self) -> "_Mot":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._files.close()
        if kind is None:
            for sequence in self.sequences.values():
                self._describe(sequence)

    def add(self, people: People, boxes: list[_Box], image_bgr: NDArray[np.uint8]) -> Path:
        """Write detections and tracks; return the path for the image."""
        height, width = image_bgr.shape[:2]
        sequence = self.sequences.get((people.camera, width, height))
        if sequence is None:
            sequence = self.sequences[people.camera, width, height] = self._begin(people.camera, width, height)
        sequence.stamps_ns.append(people.stamp_ns)
        frame = len(sequence.stamps_ns)
        for box in boxes:
            # Frames, identities and pixels count from 1 there.
            place = f"{box.left + 1:.2f},{box.top + 1:.2f},{box.width:.2f},{box.height:.2f}"
            identity = sequence.ids.setdefault(box.person.track, len(sequence.ids) + 1)
            sequence.people.setdefault(identity, set()).add(box.person.person_id)
            sequence.det.write(f"{frame},-1,{place},{box.person.confidence:.4f},-1,-1,-1\n")
            sequence.gt.write(f"{frame},{identity},{place},1,1,1\n")
        image = sequence.folder / "img1" / f"{frame:06d}.jpg"
        self.paths.append(image)
        return image

    def _begin(self, camera: str, width: int, height: int) -> _Sequence:
        names = {sequence.folder.name for sequence in self.sequences.values()}
        name, number = f"{camera_file_name(camera)}-machine-made", 2
        while name in names:
            name, number = f"{camera_file_name(camera)}-{number}-machine-made", number + 1
        folder = self._folder / name
        for part in ("img1", "det", "gt"):
            (folder / part).mkdir(parents=True)
        det = self._files.enter_context((folder / "det" / "det.txt").open("w", encoding="utf-8"))
        gt = self._files.enter_context((folder / "gt" / "gt.txt").open("w", encoding="utf-8"))
        return _Sequence(folder, width, height, det, gt)

    def _describe(self, sequence: _Sequence) -> None:
        stamps_ns = sequence.stamps_ns
        span_s = (stamps_ns[-1] - stamps_ns[0]) / 1e9
        rate_hz = (len(stamps_ns) - 1) / span_s if span_s else 0.0
        seqinfo = sequence.folder / "seqinfo.ini"
        seqinfo.write_text(
            f"[Sequence]\nname={sequence.folder.name}\nimDir=img1\nframeRate={max(1, round(rate_hz))}\n"
            f"seqLength={len(stamps_ns)}\nimWidth={sequence.width_px}\nimHeight={sequence.height_px}\nimExt=.jpg\n",
            encoding="utf-8",
        )
        notice_path = sequence.folder / "gt" / "MACHINE-MADE.txt"
        notice_path.write_text(
            (
                "gt.txt contains the tracks of the recording's own tracker. They have not been corrected, so "
                "they are not ground truth\nyet. The file has this name because tools for the MOT format look "
                "for it.\n"
            ),
            encoding="utf-8",
        )
        times = sequence.folder / "frames.csv"
        clock = self._session.clock
        with times.open("w", encoding=self._csv.encoding, newline="") as file:
            rows = self._csv.writer(file)
            rows.writerow(("frame", "session_s", "utc", "stamp_ns"))
            for number, stamp_ns in enumerate(stamps_ns, start=1):
                rows.writerow((number, round(clock.session_s(stamp_ns), 6), clock.utc(stamp_ns), stamp_ns))
        tracks = sequence.folder / "tracks.csv"
        with tracks.open("w", encoding=self._csv.encoding, errors="replace", newline="") as file:
            rows = self._csv.writer(file)
            rows.writerow(("id", "track", "person_ids"))
            for track, identity in sequence.ids.items():
                rows.writerow((identity, track, " ".join(sorted(sequence.people[identity]))))
        self.paths += [
            seqinfo, notice_path, times, tracks, sequence.folder / "det" / "det.txt", sequence.folder / "gt" / "gt.txt"
        ]  # fmt: skip


def _rate(most_hz: float | None) -> str:
    return "every processed frame" if most_hz is None else f"at most {most_hz:g} frames per second"


def _readme(session: Session, yolo: _Yolo, mot: _Mot, *, driving: Written, dialogue: Written, missing: int) -> str:
    version = session.header.get("program_version", "")
    without = f" {missing} detections of people without a frame in the video were left out.\n" if missing else ""
    sequences = ", ".join(sequence.folder.name for sequence in mot.sequences.values()) or "none"
    clock = session.clock
    clock_summary = robot_clock(session).summary(
        utc_ns_at=clock.anchor.utc_ns_at(session.started_ns), session_ns_at=session.started_ns
    )
    robot = "In this session, the robot's clock is unknown."
    if clock_summary is not None:
        robot = (
            f"In this session, it is accurate to {clock_summary.uncertainty_ms:.1f} ms "
            f"({clock_summary.estimates} measurements)."
        )
    return f"""# Data card: session {session.folder.name}

Recorded by CARIS Desktop {version} in a Wizard-of-Oz study: a person (the wizard) drove the robot and chose what it
said. Started {clock.utc(clock.started_ns)}, duration {session.duration_s:.1f} s. People are identified by opaque ids.
The images show people, and the texts contain what was said: handle both as the consent of the study requires.

## Clock
`session_s` and all times that end in `_s` are seconds since the start of the session, on one monotonic clock. `utc` is
the same time in UTC, from the clock of the recording computer. `stamp_ns` is the same time in nanoseconds of the
monotonic clock, as in the session's `events.mcap`. `age_s` is the age of a value. If the robot's clock is known, it is
the time since the measurement, from the robot's timestamp; otherwise it is the time since the arrival at the console.
{robot}

## yolo/ ({yolo.images["train"]} + {yolo.images["val"]} images, {yolo.boxes} boxes)
{_rate(yolo.most_hz).capitalize()} of each camera.{without} `labels/*/NAME.txt`: a line for each person, as
`class x y width height`, class 0 = person, centre and size as fractions of the image. An empty file: no people
detected. `boxes.csv` adds time, track, person id, confidence (0..1) and pixels (from the upper left corner, from 0).
The boxes come **from a detector and a tracker, and have not been corrected**. `val` is the last fifth of the session;
images of one session resemble each other, so test on other sessions.

## mot/ ({sequences})
{_rate(mot.most_hz).capitalize()} of each camera, in the MOTChallenge layout. `det/det.txt`:
`frame,-1,left,top,width,height,confidence,-1,-1,-1`; `gt/gt.txt`: `frame,id,left,top,width,height,1,1,1`, both in
pixels, counted from 1. **The tracks are machine-made**, see `gt/MACHINE-MADE.txt`. `frames.csv`: time of each frame;
`tracks.csv`: track number and person ids of each id. `frameRate` is the rounded mean: the frame interval is not
constant.

## driving/ ({driving.episodes} episodes, {driving.steps} steps)
`episodes.jsonl` lists the episodes, `episode-NNNN.jsonl` has a line for each step of 0.1 s. Every line contains its
`session`, `participant`, `condition` and `trial`, here and in `dialogue/`. An episode starts with the first velocity
other than zero and ends after 2 s without one; it includes 0.5 s of rest at its end.
`state` is the latest data that had arrived at the console at the start of the step; null if unknown or older than 5 s:
- `pictures`: the newest frame of each camera that had one: `image` is a file next to the steps, at most
  {PICTURE_WIDTH_PX} pixels wide; `frame_sequence` as in the session's `events.mcap`. A frame shared by several steps is
  stored once; a camera is absent if its video lacks the frame.
- `scan`: `ranges_m` in metres, null for no return; beam i points along
  `angle_min_rad + i * angle_increment_rad` from the laser, which is mounted at `robot_from_laser` (null if unknown).
- `pose_in_map`: `x_m`, `y_m`, `heading_rad` (counter-clockwise) of the robot in its map.
- `odometry`: pose in the drifting odometry frame, and velocity in the robot's own frame (m/s, rad/s, left positive).
- `goal`: the active navigation goal, null without one. A goal moves the robot without commands from the wizard.
- `people_in_map`: positions in the map, metres, `spread_m` is one standard deviation; `people_in_view`: boxes, pixels.

`action` is the velocity in effect at the end of the step, as sent to the robot: after ramps, limits and the obstacle
guard. `source` is the wizard's input device: keyboard, gamepad, onscreen; or rehearsal (scripted), stop and lease (the
program ended the motion), none.

## dialogue/ ({dialogue.episodes} turns)
`turns.jsonl`: a line for each utterance of the robot, spoken or only requested.
- `decided_s`: time of the wizard's request. `context` is the situation at that time.
- `context.transcript`: up to {20} previous utterances, oldest first; `ended_s` null: not yet finished.
- `context.people_in_view`: number of people in view of each camera.
- `context.assistant`: exchanges with a language model that were answered since the previous turn: prompt, answer, `cut`
  (empty; `length` or `filter` if the answer is truncated), and
  its final use (`said`, `edited`, `dismissed`, `unused`).
- `action.text`, and `action.origin`: `typed`, `phrase` (prepared), `filler`, `suggestion`, `assistant` (a language
  model's answer, unchanged), `edited` (an answer that the wizard changed), `heard` (from an imported recording).
- `action.state`: finished, interrupted, failed, requested (never said), started (its end is unknown). `action.said`:
  at least a part of it was audible.
- `response_time_s`: from the end of the participant's utterance to the start of this one; null if it is not a response:
  no participant spoke before, or more than 30 s passed. `wizard_reaction_time_s`: from the end of the participant's
  utterance, or from the model's answer if that came later, to `decided_s`.
"""
