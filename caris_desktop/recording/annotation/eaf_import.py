"""Import annotations from ELAN files (.eaf), from this program or others.

Format: https://www.mpi.nl/tools/elan/EAFv3.0.xsd; older versions with plain vocabularies are read too.
"""

import json
import logging
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote
from xml.etree.ElementTree import Element, ParseError

from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.recording.annotation.annotation_editing import (
    LONGEST_NAME,
    LONGEST_VALUE,
    AnnotationError,
    check_document,
    plain_text,
    sorted_document,
    time_text,
    with_moments,
)
from caris_desktop.recording.annotation.annotation_model import (
    Annotation,
    AnnotationDocument,
    Tier,
    Vocabulary,
    VocabularyEntry,
)
from caris_desktop.recording.annotation.annotation_store import file_content
from caris_desktop.recording.session.session_header import SessionHeader

PROPERTY = "caris-desktop"  # property with the exporter's notes on data that ELAN has no field for
_MOST_ELEMENTS = 2_000_000
_LATEST_MS = 2**32 - 1
_log = logging.getLogger(__name__)


def read_eaf(path: Path, *, coder: str = "", media_began_ms: Mapping[str, int] | None = None) -> AnnotationDocument:
    """Read tiers, vocabularies and annotations of an .eaf, in milliseconds of the document.

    The coded media may be a session's own video rather than our export: ``media_began_ms`` (see
    :func:`media_began_ms_of`) gives the start of each media file, and the times are shifted to session time.

    ``coder`` owns the tiers without an annotator; tiers that this program derived from the recording stay without a
    coder. Time slots without a value are spread evenly between known ones, and annotations that refer to others share
    their time. Values that a vocabulary lacks are added to it, as ELAN displays them too.

    Raises
    ------
    AnnotationError
        If the file cannot be read or breaks the rules of annotations; the text is for people.
    """
    content = file_content(path)
    try:
        root = _parse(content)
        return _document(root, coder, _moved_ms(root, media_began_ms or {}))
    except AnnotationError as error:
        raise AnnotationError(QT_TR_NOOP("{file} cannot be imported. {error}"), file=path.name, error=error) from error


def media_began_ms_of(header: SessionHeader) -> dict[str, int]:
    """Start of each video and audio file of a session by name, in ms from the session start."""
    first_ns = {one.file_name: one.first_stamp_ns for one in header.videos}
    first_ns |= {one.file_name: one.first_stamp_ns for one in header.audio}
    return {name: round((stamp_ns - header.started_ns) / 1e6) for name, stamp_ns in first_ns.items()}


class _Ours(Value):
    """Notes of our exporter: the duration, (tier id, name) per TIER_ID, our id per ANNOTATION_ID."""

    duration_ms: int
    tiers: dict[str, tuple[str, str]]
    annotations: dict[str, str]


@dataclass(slots=True)
class _Item:
    """One annotation of the file: either its slots or the annotation that it refers to is known."""

    xml_id: str
    tier_name: str
    value: str
    slots: tuple[str, str] | None = None
    parent: str = ""
    previous: str = ""


def _parse(content: bytes) -> Element:
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import fromstring

    try:
        root: Element = fromstring(content, forbid_dtd=True)
    except ParseError as error:
        raise AnnotationError(
            QT_TR_NOOP("The file is not valid XML, or is truncated: {error}."), error=error
        ) from error
    except (DefusedXmlException, ValueError, LookupError, RecursionError) as error:
        raise AnnotationError(
            QT_TR_NOOP("The file contains XML that is not allowed in an ELAN file ({kind}), so it was not read."),
            kind=type(error).__name__,
        ) from error
    if root.tag != "ANNOTATION_DOCUMENT":
        raise AnnotationError(QT_TR_NOOP("The file is not an ELAN file: it starts with “{tag}”."), tag=root.tag[:40])
    if sum(1 for _ in root.iter()) > _MOST_ELEMENTS:
        raise AnnotationError(QT_TR_NOOP("The file contains too many elements."))
    return root


def _moved_ms(root: Element, began_ms: Mapping[str, int]) -> int:
    """Offset from document time to session time in ms, by the first linked media file that belongs to the session."""
    if any(item.get("NAME") == PROPERTY for item in root.iterfind("HEADER/PROPERTY")):
        return 0  # our export, already in session time
    for media in root.iterfind("HEADER/MEDIA_DESCRIPTOR"):
        name = unquote(media.get("MEDIA_URL", "")).replace("\\", "/").rpartition("/")[2]
        origin = media.get("TIME_ORIGIN", "0")
        if name in began_ms and re.fullmatch(r"-?[0-9]{1,10}", origin):
            return began_ms[name] + int(origin)
    return 0


def _document(root: Element, coder: str, moved_ms: int) -> AnnotationDocument:
    ours = _noted(root)
    vocabularies = {vocabulary.name: vocabulary for vocabulary in map(_vocabulary, root.iter("CONTROLLED_VOCABULARY"))}
    vocabulary_of_type = {
        kind.get("LINGUISTIC_TYPE_ID", ""): plain_text(kind.get("CONTROLLED_VOCABULARY_REF", ""))
        for kind in root.iter("LINGUISTIC_TYPE")
    }
    tiers: dict[str, Tier] = {}
    for element in root.findall("TIER"):
        xml_name = element.get("TIER_ID", "")
        if not xml_name or xml_name in tiers:
            duplicate, missing = QT_TR_NOOP("Duplicate tier name “{tier}”."), QT_TR_NOOP("A tier has no name.")
            raise AnnotationError(duplicate if xml_name else missing, tier=xml_name)
        tier_id, name = ours.tiers.get(xml_name, ("", ""))
        whose = plain_text(element.get("ANNOTATOR", "")).strip()
        vocabulary = vocabulary_of_type.get(element.get("LINGUISTIC_TYPE_REF", ""), "")
        tiers[xml_name] = Tier(
            tier_id=tier_id or f"eaf-{len(tiers) + 1}",
            name=name or plain_text(xml_name)[:LONGEST_NAME],
            # One of our tiers without a coder was derived from the recording.
            coder=whose or ("" if tier_id else coder),
            vocabulary=vocabulary if vocabulary in vocabularies else "",
            participant=plain_text(element.get("PARTICIPANT", "")),
        )
    items = {item.xml_id: item for item in _items(root)}
    spans = _spans(items, _slot_times(root, items))
    annotations = []
    for item in items.values():
        tier = tiers[item.tier_name]
        start_ms, end_ms = (at_ms + moved_ms for at_ms in spans[item.xml_id])
        if end_ms < start_ms:
            raise AnnotationError(
                QT_TR_NOOP("An annotation on the tier “{tier}” at {time} ends before it starts."),
                tier=tier.name,
                time=time_text(start_ms),
            )
        annotation_id = ours.annotations.get(item.xml_id, item.xml_id)
        annotations.append(Annotation(annotation_id, tier.tier_id, start_ms, end_ms, item.value))
    document = sorted_document(
        AnnotationDocument(
            tuple(tiers.values()), tuple(vocabularies.values()), tuple(with_moments(annotations)), ours.duration_ms
        )
    )
    document = _with_values_used(document)
    check_document(document)
    return document


def _noted(root: Element) -> _Ours:
    """Exporter notes; if they are absent, changed or damaged, only the ids are lost."""
    nothing = _Ours(0, {}, {})
    texts = [item.text or "" for item in root.iterfind("HEADER/PROPERTY") if item.get("NAME") == PROPERTY]
    if not texts:
        return nothing
    try:
        data = json.loads(texts[0])
        tiers = {str(name): (str(tier_id), str(own)) for name, (tier_id, own) in data["tiers"].items()}
        annotations = {str(xml_id): str(own) for xml_id, own in data["annotations"].items()}
        duration_ms = int(data["duration_ms"])
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        _log.warning("notes of the exporter are left out: %r", error)
        return nothing
    latest = max((int(slot.get("TIME_VALUE", "0")) for slot in root.iter("TIME_SLOT") if _is_time(slot)), default=0)
    # ELAN has no session end: annotations added there may lie later.
    return _Ours(duration_ms if duration_ms >= latest else 0, tiers, annotations)


def _is_time(slot: Element) -> bool:
    text = slot.get("TIME_VALUE", "")
    return text.isascii() and text.isdigit() and len(text) <= 10 and int(text) <= _LATEST_MS


def _vocabulary(element: Element) -> Vocabulary:
    entries: dict[str, VocabularyEntry] = {}
    for entry in element:
        # Several languages: the first one; before version 2.8 there was one and no CVE_VALUE.
        value = entry.find("CVE_VALUE") if entry.tag == "CV_ENTRY_ML" else entry if entry.tag == "CV_ENTRY" else None
        if value is not None and (text := plain_text(value.text or "")):
            entries.setdefault(text, VocabularyEntry(text, plain_text(value.get("DESCRIPTION", ""))))
    described = element.find("DESCRIPTION")
    description = element.get("DESCRIPTION", "") if described is None else described.text or ""
    return Vocabulary(plain_text(element.get("CV_ID", "")), tuple(entries.values()), plain_text(description))


def _items(root: Element) -> Iterator[_Item]:
    seen: set[str] = set()
    for tier in root.findall("TIER"):
        for element in (child for annotation in tier.findall("ANNOTATION") for child in annotation):
            xml_id = element.get("ANNOTATION_ID", "")
            value = plain_text(element.findtext("ANNOTATION_VALUE") or "")
            name = tier.get("TIER_ID", "")
            if not xml_id or xml_id in seen:
                raise AnnotationError(
                    QT_TR_NOOP("Annotations on the tier “{name}” have a missing or duplicate id (“{id}”)."),
                    name=name,
                    id=xml_id[:40],
                )
            if len(value) > LONGEST_VALUE:
                raise AnnotationError(
                    QT_TR_NOOP("A text on the tier “{tier}” has %n characters; the maximum is {most}.", "", len(value)),
                    tier=name,
                    most=LONGEST_VALUE,
                )
            seen.add(xml_id)
            if element.tag == "ALIGNABLE_ANNOTATION":
                slots = (element.get("TIME_SLOT_REF1", ""), element.get("TIME_SLOT_REF2", ""))
                yield _Item(xml_id, name, value, slots=slots)
            elif element.tag == "REF_ANNOTATION":
                parent, previous = element.get("ANNOTATION_REF", ""), element.get("PREVIOUS_ANNOTATION", "")
                yield _Item(xml_id, name, value, parent=parent, previous=previous)


def _slot_times(root: Element, items: dict[str, _Item]) -> dict[str, int]:
    """Time of each slot; slots without a value are spread evenly along their chain of annotations."""
    times: dict[str, int] = {}
    unknown: set[str] = set()
    for slot in root.iterfind("TIME_ORDER/TIME_SLOT"):
        name = slot.get("TIME_SLOT_ID", "")
        if _is_time(slot):
            times[name] = int(slot.get("TIME_VALUE", ""))
        elif slot.get("TIME_VALUE") is None:
            unknown.add(name)
        else:
            raise AnnotationError(QT_TR_NOOP("The time slot “{name}” has no valid time."), name=name[:40])
    following = {item.slots[0]: item for item in items.values() if item.slots is not None and item.slots[1] in unknown}
    ends = {item.slots[0]: item.slots[1] for item in items.values() if item.slots is not None}
    for start in list(following):
        if start not in times:
            continue
        chain = [start]
        while chain[-1] in ends and ends[chain[-1]] in unknown and ends[chain[-1]] not in times:
            chain.append(ends[chain[-1]])
            if len(chain) > len(items) + 1:
                raise AnnotationError(QT_TR_NOOP("The sequence of annotations forms a loop."))
        last = ends.get(chain[-1], "")
        if last in times:
            for number, name in enumerate(chain[1:], start=1):
                times[name] = times[start] + (times[last] - times[start]) * number // len(chain)
    return times


def _spans(items: dict[str, _Item], times: dict[str, int]) -> dict[str, tuple[int, int]]:
    """Start and end of each annotation."""
    spans: dict[str, tuple[int, int]] = {}
    waiting: dict[tuple[str, str], list[_Item]] = {}
    for item in items.values():
        if item.slots is None:
            waiting.setdefault((item.parent, item.tier_name), []).append(item)
        elif item.slots[0] not in times or item.slots[1] not in times:
            raise AnnotationError(
                QT_TR_NOOP("An annotation on the tier “{tier}” has no time (“{value}”)."),
                tier=item.tier_name,
                value=item.value[:40],
            )
        else:
            spans[item.xml_id] = (times[item.slots[0]], times[item.slots[1]])
    while waiting:
        ready = [key for key in waiting if key[0] in spans]
        if not ready:
            _, name = next(iter(waiting))
            raise AnnotationError(
                QT_TR_NOOP("Annotations on the tier “{name}” refer to a missing annotation, or form a loop."), name=name
            )
        for key in ready:
            start_ms, end_ms = spans[key[0]]
            parts = _in_sequence(waiting.pop(key))
            for number, item in enumerate(parts):
                spans[item.xml_id] = (
                    start_ms + (end_ms - start_ms) * number // len(parts),
                    start_ms + (end_ms - start_ms) * (number + 1) // len(parts),
                )
    return spans


def _in_sequence(parts: list[_Item]) -> list[_Item]:
    """Parts sorted by their previous-annotation references; in file order if these are incomplete."""
    following = {item.previous: item for item in parts if item.previous}
    ordered: list[_Item] = []
    at = next((item for item in parts if not item.previous), None)
    while at is not None and len(ordered) < len(parts):
        ordered.append(at)
        at = following.get(at.xml_id)
    return ordered if len({item.xml_id for item in ordered}) == len(parts) else parts


def _with_values_used(document: AnnotationDocument) -> AnnotationDocument:
    used: dict[str, dict[str, Any]] = {}
    vocabulary_of_tier = {tier.tier_id: tier.vocabulary for tier in document.tiers if tier.vocabulary}
    for item in document.annotations:
        if item.value and item.tier_id in vocabulary_of_tier:
            used.setdefault(vocabulary_of_tier[item.tier_id], {})[item.value] = None
    vocabularies = []
    for vocabulary in document.vocabularies:
        known = {entry.value for entry in vocabulary.entries}
        added = tuple(VocabularyEntry(value) for value in used.get(vocabulary.name, {}) if value not in known)
        vocabularies.append(Vocabulary(vocabulary.name, (*vocabulary.entries, *added), vocabulary.description))
    return AnnotationDocument(document.tiers, tuple(vocabularies), document.annotations, document.duration_ms)
