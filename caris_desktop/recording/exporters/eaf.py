"""ELAN export: a project with annotations and its media files.

ELAN plays a file at document time plus its ``TIME_ORIGIN``, so it can skip the beginning of a file but cannot start one
later. A camera or microphone that began after the session is therefore padded: the first frame is held until the
second, audio is filled with silence. Nothing is re-encoded.

Format: https://www.mpi.nl/tools/elan/EAFv3.0.xsd
"""

import json
import logging
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from urllib.parse import quote
from xml.etree import ElementTree

from caris_desktop.domain.free_names import free_name
from caris_desktop.domain.media_checks import FILM_OPTIONS
from caris_desktop.domain.sensing import AudioBlock
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.annotation.annotation_editing import merge_documents, plain_text
from caris_desktop.recording.annotation.annotation_import import PROPERTY
from caris_desktop.recording.annotation.annotation_model import AnnotationDocument, shown_names
from caris_desktop.recording.annotation.session_tiers import session_tiers
from caris_desktop.recording.annotation.timeline_builder import sound_runs
from caris_desktop.recording.anonymising.pseudonymous_copy import copy_file
from caris_desktop.recording.pseudonyms import coding_of
from caris_desktop.recording.session.media_files import WavReader, moments_words, wav_header
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session_export import ExportContext

FREE_TEXT = "free text"
_XSI = "http://www.w3.org/2001/XMLSchema-instance"
_SCHEMA = "http://www.mpi.nl/tools/elan/EAFv3.0.xsd"
_LANGUAGE = {"LANG_ID": "und", "LANG_DEF": "http://cdb.iso.org/lg/CDB-00130975-001", "LANG_LABEL": "undetermined (und)"}
_CONSTRAINTS = {
    "Time_Subdivision": "Time subdivision of parent annotation's time interval, no time gaps allowed within this "
    "interval",
    "Symbolic_Subdivision": "Symbolic subdivision of a parent annotation. Annotations refering to the same parent are "
    "ordered",
    "Symbolic_Association": "1-1 association with a parent annotation",
    "Included_In": "Time alignable annotations within the parent annotation's time interval, gaps are allowed",
}
# Readers parse a number from an id, so there is one; time slots and languages share one namespace with it.
_USABLE_ID = re.compile(r"(?!ts\d|und$)[A-Za-z_][A-Za-z0-9_.-]*\d[A-Za-z0-9_.-]*")
_PLAIN_NAME = re.compile(r"[\w][\w .-]*")
_LARGEST_WAV_BYTES = 2**32 - 4096
_SOUND_ALIGNED_NS = 15_000_000
_SILENCE_FRAMES = 1 << 16
_log = logging.getLogger(__name__)


class LinkedMedia(Value):
    """One media file next to the .eaf, shown at document time plus ``time_origin_ms``."""

    file_name: str
    mime_type: str
    time_origin_ms: int
    note: str


def write_eaf(session: Session, out: Path, context: ExportContext) -> list[Path]:
    """Fill the empty folder ``out``. Raises OSError, SessionError."""
    coded = coding_of(session, on_damaged=context.warn)
    record = session_tiers(session, lambda fraction: context.progress(0.3 * fraction))
    document = merge_documents(record, coded)
    media = list(_media(session, out, lambda fraction: context.progress(0.3 + 0.65 * fraction)))
    eaf = out / f"{session.folder.name}.eaf"
    eaf.write_text(eaf_text(document, media=media, licence=context.licence), encoding="utf-8", newline="\n")
    about = out / "media.txt"
    about.write_text(_about_media(session, media), encoding="utf-8", errors="replace")
    context.progress(1.0)
    return [eaf, about, *(out / item.file_name for item in media)]


def eaf_text(document: AnnotationDocument, *, media: Iterable[LinkedMedia] = (), licence: str = "") -> str:
    """Text of an .eaf file; ``read_eaf`` restores the same document.

    Texts are written as :func:`plain_text` returns them.
    """
    root = ElementTree.Element(
        "ANNOTATION_DOCUMENT",
        {
            "AUTHOR": "CARIS Desktop",
            "DATE": datetime.now(UTC).isoformat(timespec="seconds"),
            "FORMAT": "3.0",
            "VERSION": "3.0",
            "xmlns:xsi": _XSI,
            "xsi:noNamespaceSchemaLocation": _SCHEMA,
        },
    )
    if licence:
        url = licence if re.match(r"https?://", licence) else f"https://spdx.org/licenses/{quote(licence)}.html"
        _child(root, "LICENSE", plain_text(licence), LICENSE_URL=url)
    names = _unique(shown_names(document.tiers))
    ids = _annotation_ids(document)
    _add_header(root, document, names, ids, media)
    slots = _add_time_order(root, document)
    types = {"": FREE_TEXT, **_unique({vocabulary.name: vocabulary.name for vocabulary in document.vocabularies})}
    entry_ids = {
        (vocabulary.name, entry.value): f"cve-{number}-{index}"
        for number, vocabulary in enumerate(document.vocabularies, start=1)
        for index, entry in enumerate(vocabulary.entries, start=1)
    }
    for tier in document.tiers:
        attributes = {"LINGUISTIC_TYPE_REF": types[tier.vocabulary], "TIER_ID": names[tier.tier_id]}
        if tier.participant:
            attributes["PARTICIPANT"] = plain_text(tier.participant)
        if tier.coder:
            attributes["ANNOTATOR"] = plain_text(tier.coder)
        element = _child(root, "TIER", **attributes)
        for item in document.of_tier(tier.tier_id):
            start, end = slots[item.annotation_id]
            attributes = {"ANNOTATION_ID": ids[item.annotation_id], "TIME_SLOT_REF1": start, "TIME_SLOT_REF2": end}
            if tier.vocabulary and (tier.vocabulary, item.value) in entry_ids:
                attributes["CVE_REF"] = entry_ids[tier.vocabulary, item.value]
            alignable = _child(_child(element, "ANNOTATION"), "ALIGNABLE_ANNOTATION", **attributes)
            _child(alignable, "ANNOTATION_VALUE", plain_text(item.value))
    _child(root, "LINGUISTIC_TYPE", GRAPHIC_REFERENCES="false", LINGUISTIC_TYPE_ID=FREE_TEXT, TIME_ALIGNABLE="true")
    for vocabulary in document.vocabularies:
        _child(
            root,
            "LINGUISTIC_TYPE",
            CONTROLLED_VOCABULARY_REF=plain_text(vocabulary.name),
            GRAPHIC_REFERENCES="false",
            LINGUISTIC_TYPE_ID=types[vocabulary.name],
            TIME_ALIGNABLE="true",
        )
    _child(root, "LANGUAGE", **_LANGUAGE)
    for stereotype, description in _CONSTRAINTS.items():
        _child(root, "CONSTRAINT", DESCRIPTION=description, STEREOTYPE=stereotype)
    for vocabulary in document.vocabularies:
        element = _child(root, "CONTROLLED_VOCABULARY", CV_ID=plain_text(vocabulary.name))
        # ELAN takes the languages of a vocabulary from its descriptions: without one, even an empty one, no entry has a
        # language, and its parser fails on the first.
        _child(element, "DESCRIPTION", plain_text(vocabulary.description), LANG_REF="und")
        for entry in vocabulary.entries:
            holder = _child(element, "CV_ENTRY_ML", CVE_ID=entry_ids[vocabulary.name, entry.value])
            described = {"DESCRIPTION": plain_text(entry.description)} if entry.description else {}
            _child(holder, "CVE_VALUE", plain_text(entry.value), LANG_REF="und", **described)
    ElementTree.indent(root, space=" ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _add_header(
    root: ElementTree.Element,
    document: AnnotationDocument,
    names: dict[str, str],
    ids: dict[str, str],
    media: Iterable[LinkedMedia],
) -> None:
    header = _child(root, "HEADER", MEDIA_FILE="", TIME_UNITS="milliseconds")
    for item in media:
        # Relative to the .eaf: no path of this computer leaves with it.
        url = f"./{quote(item.file_name)}"
        attributes = {"MEDIA_URL": url, "MIME_TYPE": item.mime_type, "RELATIVE_MEDIA_URL": url}
        if item.time_origin_ms:
            attributes["TIME_ORIGIN"] = str(item.time_origin_ms)
        _child(header, "MEDIA_DESCRIPTOR", **attributes)
    ours = {
        "duration_ms": document.duration_ms,
        "tiers": {names[tier.tier_id]: [tier.tier_id, plain_text(tier.name)] for tier in document.tiers},
        "annotations": {ids[own]: own for own in ids if ids[own] != own},
    }
    _child(header, "PROPERTY", json.dumps(ours, ensure_ascii=True, sort_keys=True), NAME=PROPERTY)
    # ELAN numbers new annotations from here on.
    numbers = [int(xml_id[1:]) for xml_id in ids.values() if re.fullmatch(r"a[0-9]{1,9}", xml_id)]
    _child(header, "PROPERTY", str(max(numbers, default=0)), NAME="lastUsedAnnotationId")


def _add_time_order(root: ElementTree.Element, document: AnnotationDocument) -> dict[str, tuple[str, str]]:
    """Write two time slots for each annotation, in order of time; return the names of both."""
    moments = sorted(
        moment
        for item in document.annotations
        for moment in ((item.start_ms, 1, item.annotation_id), (item.end_ms, 0, item.annotation_id))
    )
    order = _child(root, "TIME_ORDER")
    starts: dict[str, str] = {}
    slots: dict[str, tuple[str, str]] = {}
    for number, (at_ms, begins, annotation_id) in enumerate(moments, start=1):
        _child(order, "TIME_SLOT", TIME_SLOT_ID=f"ts{number}", TIME_VALUE=str(at_ms))
        if begins:
            starts[annotation_id] = f"ts{number}"
        else:
            slots[annotation_id] = (starts[annotation_id], f"ts{number}")
    return slots


def _child(parent: ElementTree.Element, tag: str, text: str | None = None, /, **attributes: str) -> ElementTree.Element:
    element = ElementTree.SubElement(parent, tag, attributes)
    element.text = text
    return element


def _unique(texts: dict[str, str]) -> dict[str, str]:
    """Same mapping with texts made unique and different from the name of free text."""
    taken = {FREE_TEXT}
    unique = {}
    for key, text in texts.items():
        unique[key] = free_name(plain_text(text), "", taken.__contains__, number_as=" ({})")
        taken.add(unique[key])
    return unique


def _annotation_ids(document: AnnotationDocument) -> dict[str, str]:
    """Our ids where ELAN accepts them, else ids in its form."""
    ids = {item.annotation_id for item in document.annotations}
    fresh = (f"a{number}" for number in range(1, 2 * len(ids) + 2) if f"a{number}" not in ids)
    return {
        item.annotation_id: item.annotation_id if _USABLE_ID.fullmatch(item.annotation_id) else next(fresh)
        for item in document.annotations
    }


# Media


def _media(session: Session, out: Path, progress: Callable[[float], None]) -> Iterator[LinkedMedia]:
    videos = [video for video in session.header.videos if _is_ours(session, video.file_name)]
    blocks: dict[str, list[tuple[int, int, int, int]]] = {}
    for _, value in session.values("audio"):
        if isinstance(value, AudioBlock) and _is_ours(session, value.file_name) and value.sample_rate_hz > 0:
            blocks.setdefault(value.file_name, []).append(
                (value.stamp_ns, value.first_sample, value.sample_count, value.sample_rate_hz)
            )
    count = len(videos) + len(blocks)
    for number, video in enumerate(videos):

        def report(fraction: float, number: int = number) -> None:
            progress((number + fraction) / count)

        linked = _video(session, video.file_name, video.first_stamp_ns, out, report)
        yield replace(linked, note=f"{linked.note} {moments_words(video)}")
    for number, (name, its_blocks) in enumerate(blocks.items(), start=len(videos)):
        progress(number / count)
        yield _sound(session, name, its_blocks, out)


def _is_ours(session: Session, name: str) -> bool:
    """True for a plain file in the session's folder: header fields are untrusted."""
    if not _PLAIN_NAME.fullmatch(name):
        return False
    path = session.folder / name
    try:
        return path.is_file() and not path.is_symlink()
    except OSError:
        # The name is too long for a file.
        return False


def _video(session: Session, name: str, first_ns: int, out: Path, progress: Callable[[float], None]) -> LinkedMedia:
    late_ms = (first_ns - session.started_ns) / 1e6
    if late_ms > 0.5:
        try:
            _delay_video(session.folder / name, out / name, (first_ns - session.started_ns) / 1e9, progress)
        except (ValueError, EOFError) as error:
            (out / name).unlink(missing_ok=True)
            _log.warning("%s is copied as it is: %r", name, error)
        else:
            note = f"The camera started {late_ms / 1000:.3f} s into the session; its first frame is shown until then."
            return LinkedMedia(name, "video/mp4", 0, note)
    copy_file(session.folder / name, out / name)
    return LinkedMedia(name, "video/mp4", -round(late_ms), "Unchanged from the recording.")


def _delay_video(source: Path, target: Path, delay_s: float, progress: Callable[[float], None]) -> None:
    """Remux the video with a delay; the first frame is also shown at the beginning. Raises OSError, ValueError for a
    broken video.
    """
    import av

    try:
        with av.open(str(source), options=FILM_OPTIONS) as video, av.open(str(target), "w", format="mp4") as delayed:
            stream = video.streams.video[0]
            copy = delayed.add_stream_from_template(stream)
            copy.time_base = stream.time_base
            delay = round(delay_s / stream.time_base)
            first = True
            for packet in video.demux(stream):
                if packet.pts is None or packet.dts is None:
                    continue
                if first:
                    opening = av.Packet(bytes(packet))
                    opening.pts = opening.dts = 0
                    opening.time_base, opening.stream, opening.is_keyframe = stream.time_base, copy, True
                    delayed.mux(opening)
                    first = False
                elif stream.duration:
                    progress(min(float(packet.pts / stream.duration), 1.0))
                packet.pts, packet.dts, packet.stream = packet.pts + delay, packet.dts + delay, copy
                delayed.mux(packet)
            if first:
                raise ValueError("no picture in it")
    except av.error.FFmpegError as error:
        # PyAV's operating system errors are OSErrors too: a full disk must not pass for a broken video.
        if isinstance(error, OSError) and error.errno in (28, 122):
            raise
        raise ValueError(str(error)) from error


def _sound(session: Session, name: str, blocks: list[tuple[int, int, int, int]], out: Path) -> LinkedMedia:
    runs = sound_runs(blocks, within_ns=_SOUND_ALIGNED_NS)
    late_ns = min(run[0] for run in runs) - session.started_ns
    mime = "audio/x-wav"
    if late_ns > 0 or len(runs) > 1:
        try:
            _place_sound(session, session.folder / name, runs, out / name)
        except ValueError as error:
            (out / name).unlink(missing_ok=True)
            _log.warning("%s is copied as it is: %s", name, error)
        else:
            note = f"Silence replaces gaps in the recording, including {max(late_ns, 0) / 1e9:.3f} s at the start."
            return LinkedMedia(name, mime, 0, note)
    copy_file(session.folder / name, out / name)
    return LinkedMedia(name, mime, -round(late_ns / 1e6), "Unchanged from the recording.")


def _place_sound(session: Session, source: Path, runs: list[tuple[int, int, int, int]], target: Path) -> None:
    """Place each sample at its session time. Raises OSError, ValueError if it is not a session's audio file."""
    with WavReader(source) as wav, target.open("wb") as writing:
        rate, frame_bytes = wav.sample_rate_hz, 2 * wav.channels
        last_ns = max(stamp_ns + count * 1_000_000_000 // rate for stamp_ns, _, count, _ in runs)
        longest_ns = (_LARGEST_WAV_BYTES // frame_bytes) * 1_000_000_000 // rate
        if last_ns - session.started_ns > min(longest_ns, 2 * (session.ended_ns - session.started_ns) + 60_000_000_000):
            raise ValueError("it would become too large a file")
        writing.write(wav_header(wav.channels, rate, 0))
        written = 0
        for stamp_ns, first, count, _ in sorted(runs):
            due = round((stamp_ns - session.started_ns) * rate / 1e9)
            skipped = max(written - due, 0)
            while written < due:
                silent = min(due - written, _SILENCE_FRAMES)
                writing.write(bytes(silent * frame_bytes))
                written += silent
            for content in wav.read_bytes(first + skipped, count - skipped):
                writing.write(content)
                written += len(content) // frame_bytes
        writing.seek(0)
        writing.write(wav_header(wav.channels, rate, written))


def _about_media(session: Session, media: Iterable[LinkedMedia]) -> str:
    lines = [
        f"Session {session.folder.name}, started at {session.clock.utc(session.started_ns)} (UTC).",
        "Times in the .eaf file are milliseconds since then. The files next to it:",
        "",
    ]
    for item in media:
        lines.append(f"{item.file_name}: {item.note}")
        if item.time_origin_ms:
            lines.append(
                f"  Its time is the time of the document plus {item.time_origin_ms} ms (TIME_ORIGIN in the .eaf file)."
            )
    return "\n".join(lines) + "\n"
