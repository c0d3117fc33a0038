"""Anonymised copy of a session folder: pseudonyms for names, faces covered by consent, voices changed or removed.

The copy is a session like any other, with a manifest of its own. What cannot be anonymised is left out, and said.
"""

import hashlib
import itertools
import json
import logging
import re
import unicodedata
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import field, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop import __version__
from caris_desktop.domain.events import ConsentNoted, PhotoTaken, RobotChosen, ScenarioOpened
from caris_desktop.domain.file_replacement import narrow
from caris_desktop.domain.foreign_text import parse_json
from caris_desktop.domain.media_checks import FILM_OPTIONS
from caris_desktop.domain.person_marks import with_names
from caris_desktop.domain.schema_fields import literals_of
from caris_desktop.domain.sensing import People, StatusShown
from caris_desktop.domain.sound_values import ROBOT_VOICE
from caris_desktop.domain.streams import BY_TYPE, StreamSpec, spec_of_topic
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.annotation.annotation_editing import AnnotationError
from caris_desktop.recording.annotation.annotation_store import annotation_files
from caris_desktop.recording.anonymising.pseudonymous_copy import CODINGS, copy_file, renamed_coding
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.forgetting import media
from caris_desktop.recording.forgetting.media import Cover, UnreadableMediaError, sound_span_of
from caris_desktop.recording.forgetting.text_erasure import PersonNames, changed_metadata, encoding_of, lines_of
from caris_desktop.recording.photo_file import PhotoFileError, change_texts, texts_of
from caris_desktop.recording.pseudonyms import Pseudonyms, address_scrubber, other_wizards, scrubber_of
from caris_desktop.recording.recorder.blurring import Covering, detections_around, parts_at
from caris_desktop.recording.recorder.recorder_messages import BlurDemand, UseConsents
from caris_desktop.recording.session import events_file
from caris_desktop.recording.session.events_file import ATTACHMENT, copy_changed
from caris_desktop.recording.session.manifest import session_files, write_manifest
from caris_desktop.recording.session.media_files import (
    INDEX_SUFFIX,
    WavReader,
    index_path,
    wav_header,
)
from caris_desktop.recording.session.recovery import missing_words
from caris_desktop.recording.session.session_data import spoken
from caris_desktop.recording.session.session_header import (
    HEADER_NAME,
    Anonymised,
    clock_text,
    header_of,
    recorded_files,
)
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.study_file import FILE_NAME as STUDY_FILE

# Known names in texts, replaced by pseudonyms.

_SEVERAL = "[name]"
"""Pseudonym of a part of a name that several people have."""
_BETWEEN = re.compile(r"(?:\s|\\[nrt]|%20|&nbsp;|&#160;|[+_.-])+")
_HOME = re.compile(r"(?:/(?:home|Users)/|\b[A-Za-z]:\\Users\\)[^/\\\s\"':;,]+")
_HOMES = ("/home/", "/Users/", ":\\Users\\")
_IN_YAML = str.maketrans("[]{}", "()()")  # a bracket at the start of a value has a meaning there
_KEY_LINE = re.compile(r"(?:^[ \t-]*|[{,][ \t]*)[\"']?([a-z][a-z0-9_]*)[\"']?[ \t]*:", re.MULTILINE)
_KEY = re.compile(r"[a-z][a-z0-9_]*")
_UMLAUTS = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "Ä": "Ae", "Ö": "Oe", "Ü": "Ue", "ß": "ss"})
_LONG = 8
"""Shorter names such as Max are also words of the program, as in the key ``max``."""


class KnownNames:
    """Names with their pseudonyms. Parts of a name are replaced too, since people are called by them; so are home
    folders in paths, and ``folders``.
    """

    def __init__(self, pseudonyms: Mapping[str, str], folders: Collection[str] = ()) -> None:
        self._folders = tuple(folder for folder in folders if len(folder) > 1)
        # German names as typed elsewhere, and as a pseudonym file has them in small letters
        spelt = {
            way: pseudonym
            for name, pseudonym in pseudonyms.items()
            for way in (name.translate(_UMLAUTS), name.replace("ss", "ß"))
        }
        spelt |= pseudonyms
        self._words = PersonNames(tuple(spelt))
        self._of: dict[str, str] = {}
        whole = {_plain(name): pseudonym for name, pseudonym in spelt.items()}
        for name in spelt:
            pseudonym = whole[_plain(name)]
            for form in map(_plain, PersonNames((name,)).alternatives):
                known = self._of.setdefault(form, whole.get(form, pseudonym))
                if known != pseudonym and form not in whole:
                    self._of[form] = _SEVERAL

    def named(self, text: str) -> bool:
        """True if the text contains a known name."""
        return next(self._words.spans(text), None) is not None

    def replace(self, text: str, *, yaml: bool = False) -> str:
        """Text with pseudonyms. In YAML, keys that are words of the program stay."""
        for folder in self._folders:
            text = text.replace(folder, "~")
        keys = [match.span(1) for match in _KEY_LINE.finditer(text)] if yaml and self.named(text) else []
        return self._replace(text, keys, yaml=yaml)

    def replace_key(self, key: str) -> str:
        """Key of a JSON object with pseudonyms, unless it is a word of the program."""
        return self._replace(key, [(0, len(key))] if _KEY.fullmatch(key) else [])

    def _replace(self, text: str, keys: Collection[tuple[int, int]], *, yaml: bool = False) -> str:
        parts, at = [], 0
        for start, end in self._words.spans(text):
            if end - start < _LONG and any(begin <= start and end <= until for begin, until in keys):
                continue
            pseudonym = self._of.get(_plain(text[start:end]), _SEVERAL)
            parts += [text[at:start], pseudonym.translate(_IN_YAML) if yaml else pseudonym]
            at = end
        changed = "".join([*parts, text[at:]])
        return _HOME.sub("~", changed) if any(word in changed for word in _HOMES) else changed


def _plain(text: str) -> str:
    return _BETWEEN.sub(" ", unicodedata.normalize("NFC", text)).strip().casefold()


# Change of the pitch of voices in WAV files.


def write_sound(source: Path, target: Path, pitch: float = 1.0) -> None:
    """Rewrite a WAV file as samples alone, with the pitch of all voices multiplied by ``pitch``.

    Length and times do not change. ffmpeg's ``asetrate`` and ``atempo`` do it, since PyAV comes without ``rubberband``.
    Raises OSError, UnreadableMediaError.
    """
    with media.opened_sound(source) as wav, target.open("wb") as new:
        new.write(wav_header(wav.channels, wav.sample_rate_hz, wav.samples))
        left = wav.samples
        pieces = wav.read_bytes(0, wav.samples)
        blocks = (np.frombuffer(piece, "<i2").reshape(-1, wav.channels) for piece in pieces)
        for block in blocks if pitch == 1.0 else _changed(blocks, wav, pitch):
            part = block[:left]
            new.write(part.tobytes())
            left -= len(part)
        new.write(bytes(left * 2 * wav.channels))


def _changed(blocks: Iterator[NDArray[np.int16]], wav: WavReader, pitch: float) -> Iterator[NDArray[np.int16]]:
    import av

    rate, layout = wav.sample_rate_hz, {1: "mono", 2: "stereo"}.get(wav.channels, f"{wav.channels}c")
    graph = av.filter.Graph()
    nodes = [
        graph.add_abuffer(format="s16", sample_rate=rate, layout=layout),
        graph.add("asetrate", str(round(rate * pitch))),
        graph.add("aresample", str(rate)),
        graph.add("atempo", f"{1 / pitch:.6f}"),
        graph.add("aformat", f"sample_fmts=s16:sample_rates={rate}"),
        graph.add("abuffersink"),
    ]
    for node, following in itertools.pairwise(nodes):
        node.link_to(following)
    graph.configure()
    at = 0
    for block in itertools.chain(blocks, [None]):
        frame = None
        if block is not None:
            frame = av.AudioFrame.from_ndarray(block.reshape(1, -1), "s16", layout)
            frame.sample_rate, frame.pts = rate, at
            at += len(block)
        graph.push(frame)
        with suppress(av.error.BlockingIOError, av.error.EOFError):
            while True:
                yield graph.pull().to_ndarray().reshape(-1, wav.channels)


_log = logging.getLogger(__name__)
Voice = Literal["keep", "remove", "change"]
_EVENTS, _RECOVERED = "events.mcap", "recovered/"
_PHOTOS, _SOUNDS = (".png", ".jpg", ".jpeg"), (".wav",)
_TOLD_ANYWAY = ("movement.txt", "speech.txt", INDEX_SUFFIX)
_LARGEST_TEXT_BYTES = 64 << 20
_FREE_TEXTS = (
    "answer", "branch", "committed", "content", "detail", "heard_text", "item", "label", "message", "note", "prompt",
    "tags", "tentative", "text", "title", "value",
)  # fmt: skip
_YAML_TEXTS = {(ScenarioOpened, "content"), (RobotChosen, "profile")}
_UNNAMED = "Person "
_INITIALS = 2

_NO_PEOPLE = QT_TR_NOOP(
    "{file} is left out: it is not known where people are in its images, so that they cannot be covered."
)
_NO_VIDEO = QT_TR_NOOP("{file} is left out: the session header does not list it, so that its times are not known.")
_UNREADABLE = QT_TR_NOOP("{file} is left out: {why}.")
_WITH_SOUND = QT_TR_NOOP("{file} is left out: the video contains sound.")
_FRAMES_ALONE = QT_TR_NOOP("{file} is copied without its sound, subtitles and texts: they may name people.")
_VOICE = QT_TR_NOOP("{file} is left out: it contains voices.")
_BEFORE_REPAIR = QT_TR_NOOP("{file} is left out: a repair saved it, and it may name people.")
_UNKNOWN = QT_TR_NOOP("{file} is left out: it cannot be searched for names.")
_DAMAGED = QT_TR_NOOP("{file} is left out: it is damaged and may contain names.")


class AnonymiseOptions(Value):
    """What to hide. ``names`` are those of the study's people with their marks, ``pseudonyms`` of everybody else.

    ``consents`` lists who consented to video and to photos; None: as noted in the recording. ``voice`` applies to all
    voices but the robot's, whose pitch is multiplied by ``pitch``. With ``wizards``, their names stay.
    """

    pseudonyms: Pseudonyms
    names: dict[str, str] = field(default_factory=dict)
    consents: UseConsents | None = None
    blur: BlurDemand = BlurDemand("without_consent", "faces")
    voice: Voice = "keep"
    pitch: float = 1.0
    wizards: bool = False


class FoundText(Value):
    """Free text of the copy, to be read by a person. ``count`` is how often it is in the file."""

    file: str
    place: str
    kind: str
    text: str
    count: int = 1


def anonymise_session(
    session: Session,
    target: Path,
    options: AnonymiseOptions,
    covering: Covering,
    progress: Callable[[float], None] = lambda _: None,
) -> tuple[tuple[str, ...], tuple[FoundText, ...]]:
    """Fill the empty folder ``target``; return a sentence for each file that was left out, and the texts for review.

    Raises OSError, SessionError.
    """
    copy = _Copy(session, target, options, covering)
    copy.write(progress)
    narrow([target])
    return tuple(copy.left_out), tuple(copy.texts.values())


class _Copy:
    """One copy being made."""

    def __init__(self, session: Session, target: Path, options: AnonymiseOptions, covering: Covering) -> None:
        self._session, self._folder, self._target = session, session.folder, target
        self._options, self._covering = options, covering
        self.left_out: list[str] = []
        self.texts: dict[tuple[str, str, str], FoundText] = {}
        self._people: dict[str, list[People]] = {}
        self._photos: dict[str, PhotoTaken] = {}
        self._checksums: dict[str, str] = {}
        consents = {kind: set[str]() for kind in ("video", "photo")}
        operators = options.pseudonyms.coders | ({} if options.wizards else options.pseudonyms.wizards)
        known = options.names | options.pseudonyms.people
        # Initials such as AB are too often a condition or a word.
        known |= {name: pseudonym for name, pseudonym in operators.items() if len(name) > _INITIALS}
        scenarios: list[ScenarioOpened] = []
        for _, value in session.values(*(BY_TYPE[kind].name for kind in _BEFORE)):
            match value:
                case People():
                    self._people.setdefault(value.camera, []).append(value)
                case PhotoTaken():
                    self._photos[value.file_name] = value
                case ConsentNoted(kind=kind) if kind in consents:
                    (set.add if value.given else set.discard)(consents[kind], value.person_id)
                case ScenarioOpened():
                    scenarios.append(value)
                case StatusShown(name="persons", content=list(rows)):
                    # Imported recordings only: ours have no names there.
                    names = (str(row.get("name") or "") for row in rows if isinstance(row, dict))
                    known = {name: "{p-unknown}" for name in names if name and not name.startswith(_UNNAMED)} | known
        for people in self._people.values():
            people.sort(key=lambda each: each.stamp_ns)
        self._consents = options.consents or UseConsents(frozenset(consents["video"]), frozenset(consents["photo"]))
        if options.wizards:
            self._scrub = address_scrubber(session)
        else:
            self._scrub = scrubber_of(session, options.pseudonyms)
            known = dict.fromkeys(other_wizards(session), "another wizard") | known
        self._names = KnownNames(known, (str(session.folder.absolute().parent),))
        for scenario in scenarios:
            changed = self._names.replace(scenario.content, yaml=True)
            if changed != scenario.content:
                self._checksums[scenario.sha256] = hashlib.sha256(changed.encode("utf-8", "replace")).hexdigest()

    def write(self, progress: Callable[[float], None]) -> None:
        names = [name for name in session_files(self._folder) if name != HEADER_NAME]
        names += [path.relative_to(self._folder).as_posix() for path in annotation_files(self._folder)]
        names.sort(key=lambda name: name.endswith(INDEX_SUFFIX))  # after their videos
        sizes = {name: (self._folder / name).stat().st_size for name in names}
        total, done = max(1, sum(sizes.values())), 0
        # Session times at which a name is spoken. In texts of the robot, marks replace the names that it says.
        named_in_sound = [
            sound_span_of(one)
            for one in spoken(self._session)
            for text in [f"{one.text}\n{one.heard_text or ''}"]
            if self._names.named(text) or with_names(text, lambda _: "") != text
        ]
        for name, size in sizes.items():
            path, target = self._folder / name, self._target / self._names.replace(name)
            target.parent.mkdir(parents=True, exist_ok=True)

            def report(share: float, *, before: int = done, size: int = size) -> None:
                progress((before + share * size) / total)

            try:
                self._write_file(name, path, target, named_in_sound, report)
            except UnreadableMediaError as error:
                target.unlink(missing_ok=True)
                self._leave_out(name, _UNREADABLE, why=self._names.replace(str(error)))
            done += size
            progress(done / total)
        for folder in sorted((path for path in self._target.rglob("*") if path.is_dir()), reverse=True):
            if not any(folder.iterdir()):
                folder.rmdir()
        self._write_header()
        write_manifest(self._target)

    def _write_file(
        self,
        name: str,
        path: Path,
        target: Path,
        named_in_sound: list[tuple[int, int]],
        progress: Callable[[float], None],
    ) -> None:
        suffix = path.suffix.lower()
        if name == _EVENTS:
            self._write_events(path, target)
        elif name == STUDY_FILE:
            copy_file(path, target)
        elif name.startswith(_RECOVERED):
            self._leave_out(name, _BEFORE_REPAIR)
        elif suffix == ".mp4":
            self._write_video(name, path, target, progress)
        elif name.endswith(INDEX_SUFFIX):
            # Numbers of the video with this name.
            if any(name in (video.index_file, index_path(Path(video.file_name)).name) for video in self._videos):
                self._write_text(name, path, target, "utf-8")
        elif suffix in _SOUNDS:
            self._write_sound(name, path, target, named_in_sound)
        elif suffix in _PHOTOS:
            self._write_photo(name, path, target)
        elif name.startswith(CODINGS):
            self._write_coding(name, path)
        elif path.stat().st_size > _LARGEST_TEXT_BYTES or (encoding := encoding_of(path)) is None:
            self._leave_out(name, _UNKNOWN)
        elif suffix == ".json":
            self._write_json(name, path, target)
        else:
            self._write_text(name, path, target, encoding)

    @property
    def _videos(self) -> list[Any]:
        """Videos of the header that are in the copy: they are written before their indices and the header."""
        videos = self._session.header.videos
        return [video for video in videos if (self._target / self._names.replace(video.file_name)).is_file()]

    def _leave_out(self, name: str, sentence: str, **values: object) -> None:
        self.left_out.append(localized(sentence, file=self._names.replace(name), **values))

    def _find(self, name: str, place: str, kind: str, text: str) -> None:
        if text.strip():
            name = self._names.replace(name)
            key = name, kind, text
            known = self.texts.get(key) or FoundText(name, place, kind, text, count=0)
            self.texts[key] = replace(known, count=known.count + 1)

    # The recording

    def _write_events(self, path: Path, target: Path) -> None:
        with path.open("rb") as file:
            index = events_file.scan(file)
            specs = {number: spec_of_topic(channel.topic) for number, channel in index.channels.items()}

            def change(channel: int, data: bytes) -> bytes:
                return self._changed_message(specs.get(channel), self._scrub(data))

            def change_metadata(data: bytes) -> bytes:
                return self._names.replace(self._scrub(data).decode("utf-8", "replace")).encode()

            beside = tuple(changed_metadata(one, change_metadata) for one in index.beside if one[0] != ATTACHMENT)
            with DiskFile(target) as copy:
                copy_changed(file, replace(index, beside=beside), copy, change)

    def _changed_message(self, spec: StreamSpec | None, data: bytes) -> bytes:
        text = data.decode("utf-8", "surrogateescape")
        is_event = spec is not None and spec.name.startswith("event/")
        if not (is_event or self._names.replace(text) != text):
            return data
        try:
            message = parse_json(text)
        except ValueError:
            return self._names.replace(text).encode("utf-8", "surrogateescape")
        find = None
        automatic = isinstance(message, dict) and message.get("manual") is False  # a check in the program's own words
        if spec is not None and is_event and isinstance(message, dict) and not automatic:
            stamp_ns = message.get("stamp_ns")
            place = clock_text(self._session.clock.session_s(stamp_ns)) if isinstance(stamp_ns, int) else ""
            find = partial(self._find, _EVENTS, place, spec.name.removeprefix("event/"))
        changed = self._changed(message, spec, find)
        return data if changed == message else json.dumps(changed, separators=(",", ":")).encode()

    def _changed(
        self, value: Any, spec: StreamSpec | None = None, find: Callable[[str], None] | None = None, key: str = ""
    ) -> Any:
        """JSON value with pseudonyms; ``find`` gets its free texts."""
        if isinstance(value, dict):
            return {self._names.replace_key(name): self._changed(its, spec, find, name) for name, its in value.items()}
        if isinstance(value, list):
            return [self._changed(its, spec, find, key) for its in value]
        kind: Any = None if spec is None else spec.value_type
        if not isinstance(value, str) or key == "actor" or (kind is not None and literals_of(kind).get(key)):
            return value
        if value in self._checksums:
            return self._checksums[value]
        is_yaml = (kind, key) in _YAML_TEXTS
        text = self._names.replace(value, yaml=is_yaml)
        if find is not None and key in _FREE_TEXTS and not is_yaml:
            find(text)
        return text

    # Media

    def _write_video(self, name: str, path: Path, target: Path, progress: Callable[[float], None]) -> None:
        video = next((video for video in self._session.header.videos if video.file_name == name), None)
        is_covered = self._options.blur.who != "nobody"
        if video is None:
            self._leave_out(name, _NO_VIDEO)
            return
        besides = _besides_frames(path)
        if self._options.voice != "keep" and "audio" in besides:
            self._leave_out(name, _WITH_SOUND)
        elif is_covered and not self._people.get(video.camera):
            self._leave_out(name, _NO_PEOPLE)
        elif is_covered or besides:
            cover_at = partial(self._cover_at, video.camera, self._consents.video) if is_covered else lambda _: None
            media.covered_video(path, target, video.first_stamp_ns, cover_at, progress=progress)
            if besides:
                self._leave_out(name, _FRAMES_ALONE)
        else:
            copy_file(path, target)

    def _write_photo(self, name: str, path: Path, target: Path) -> None:
        photo, covers = self._photos.get(name), list[Cover]()
        if self._options.blur.who != "nobody":
            if photo is None or not self._people.get(photo.camera):
                self._leave_out(name, _NO_PEOPLE)
                return
            moments = [
                self._cover_at(photo.camera, self._consents.photos, photo.stamp_ns + since) for since in media.PHOTO_NS
            ]
            covers = list(filter(None, moments))

        def cover(image: NDArray[np.uint8]) -> None:
            for one in covers:
                one(image)

        media.covered_picture(path, target, cover)
        try:
            texts = texts_of(target.read_bytes())
        except PhotoFileError:
            return
        changed = {self._names.replace(key): self._names.replace(text) for key, text in texts.items()}
        change_texts(target, dict.fromkeys(texts, "") | changed)
        for key, text in changed.items():
            self._find(name, key, "photo", text)

    def _cover_at(self, camera: str, consenting: frozenset[str], stamp_ns: int) -> Cover | None:
        detections, demand = self._people[camera], self._options.blur
        near = detections_around(detections, stamp_ns)
        if near is None:
            return self._covering.cover_all
        parts = parts_at(stamp_ns, near, demand, consenting, self._covering)
        if not parts:
            return None
        width_px = detections[0].frame_width_px

        def cover(image: NDArray[np.uint8]) -> None:
            scale = image.shape[1] / width_px
            scaled = [(left * scale, top * scale, right * scale, bottom * scale) for left, top, right, bottom in parts]
            self._covering.cover(image, scaled, demand.what)

        return cover

    def _write_sound(self, name: str, path: Path, target: Path, named: list[tuple[int, int]]) -> None:
        sound = next((sound for sound in self._session.header.audio if sound.file_name == name), None)
        human = sound is None or sound.source != ROBOT_VOICE
        if human and self._options.voice == "remove":
            self._leave_out(name, _VOICE)
            return
        part = target.with_name(f".{target.name}.part")
        try:
            if sound is not None:
                media.silenced_sound(path, part, sound.first_stamp_ns, named)
            pitch = self._options.pitch if human and self._options.voice == "change" else 1.0
            write_sound(path if sound is None else part, target, pitch)
        finally:
            part.unlink(missing_ok=True)
        if sound is None:
            self._find(name, "", "sound", "Not searched for spoken names.")

    # Files next to the recording

    def _write_coding(self, name: str, path: Path) -> None:
        try:
            pseudonym, coding = renamed_coding(path, self._options.pseudonyms.coder)
        except AnnotationError:
            self._leave_out(f"{CODINGS}…", _DAMAGED)
            return
        content = self._changed(json.loads(self._scrub(coding)))
        target = self._target / CODINGS / f"{pseudonym}.json"
        target.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", "utf-8")
        name = f"{CODINGS}{pseudonym}.json"
        for vocabulary in content.get("vocabularies", ()):
            for entry in vocabulary["entries"]:
                self._find(name, vocabulary["name"], "vocabulary", f"{entry['value']} {entry.get('description', '')}")
        for tier in content["tiers"]:
            self._find(name, "", "tier", tier["name"])
            for one in tier["annotations"]:
                self._find(name, clock_text(one["start_ms"] / 1000), "annotation", one["value"])

    def _write_json(self, name: str, path: Path, target: Path) -> None:
        try:
            content = parse_json(self._scrub(path.read_bytes()))
        except ValueError:
            self._leave_out(name, _DAMAGED)
            return
        known = name == "people.json" or name.startswith("llm/")
        find = None if known else partial(self._find, name, "", "file")
        changed = self._changed(content, _LLM if name.startswith("llm/") else None, find)
        target.write_text(json.dumps(changed, indent=2, ensure_ascii=False) + "\n", "utf-8", "replace")

    def _write_text(self, name: str, path: Path, target: Path, encoding: str) -> None:
        with target.open("w", encoding="utf-8", errors="replace", newline="") as file:
            for number, line in enumerate(lines_of(path, encoding), start=1):
                scrubbed = self._scrub(line.encode("utf-8", "surrogateescape")).decode("utf-8", "replace")
                text = self._names.replace(scrubbed.lstrip("\ufeff"), yaml=path.suffix.lower() in (".yaml", ".yml"))
                file.write(text)
                if not name.endswith(_TOLD_ANYWAY):
                    self._find(name, f"line {number}", "file", text.strip())

    # The header

    def _write_header(self) -> None:
        options, header = self._options, self._session.header
        called = {"participant": options.pseudonyms.participant}
        if not options.wizards:
            called["wizard"] = options.pseudonyms.wizard
        trial = {key: self._names.replace(called.get(key, str)(text)) for key, text in header.trial.items()}
        for key, text in trial.items():
            self._find(HEADER_NAME, f"trial.{key}", "trial", text)
        # The copy has the files as they are; what was lost before is not to be seen from their sizes any more.
        missing = missing_words(header, Counter(self._session.lost) - Counter(header.lost))
        losses = (self._names.replace(loss) for loss in self._session.losses if loss not in missing)
        content = self._changed(parse_json(self._scrub(json.dumps(header.to_json()).encode())))
        copied = header_of({**content, "trial": trial}, self._target / HEADER_NAME)
        sounds = tuple(sound for sound in copied.audio if (self._target / sound.file_name).is_file())
        videos = tuple(video for video in copied.videos if (self._target / video.file_name).is_file())
        who = {"without_consent": "people without consent", "everybody": "everybody", "nobody": "nobody"}[
            options.blur.who
        ]
        copied = replace(
            copied,
            videos=videos,
            audio=sounds,
            losses=tuple(dict.fromkeys((*copied.losses, *losses))),
            files=recorded_files(self._target),
            anonymised=Anonymised(
                utc=f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
                program_version=__version__,
                names="pseudonyms for all known names" + (" but those of wizards" if options.wizards else ""),
                faces=f"{options.blur.what} covered of {who}",
                voices={"keep": "unchanged", "remove": "removed", "change": "pitch changed"}[options.voice],
                left_out=tuple(self.left_out),
            ),
            as_read={key: its for key, its in content.items() if key not in _MADE_ANEW},
        )
        copied.write(self._target)


_BEFORE = (People, PhotoTaken, ConsentNoted, ScenarioOpened, StatusShown)
_LLM = spec_of_topic("/event/llm_exchange")
_MADE_ANEW = ("videos", "audio", "files", "trial")


# Written by every encoder, about the file itself.
_OF_ENCODERS = {"major_brand", "minor_version", "compatible_brands", "encoder", "language", "handler_name", "vendor_id"}


def _besides_frames(path: Path) -> set[str]:
    """Kinds of further streams of a video, and names of its texts. Raises UnreadableMediaError."""
    import av

    try:
        with av.open(str(path), options=FILM_OPTIONS) as file:
            streams = [stream for stream in file.streams if stream.index != file.streams.video[0].index]
            texts = {*file.metadata, *file.streams.video[0].metadata} - _OF_ENCODERS
            return {*(stream.type for stream in streams), *texts, *(["chapters"] if file.chapters() else [])}
    except (av.error.FFmpegError, IndexError, ValueError) as error:
        raise UnreadableMediaError(
            localized(QT_TR_NOOP("{file} cannot be read as a video: {error}"), file=path.name, error=error)
        ) from error
