"""Edit annotations: pure functions from a document to the changed one; AnnotationError gives the reason for a refusal.

The rules are ELAN's: annotations of a tier do not overlap, a tier with a vocabulary holds its values only (or an empty
one), times lie within the session. Tiers derived from the recording are read only. Texts hold what XML can: other
control characters become U+FFFD, line ends become line feeds.
"""

import re
from bisect import bisect_left, bisect_right, insort
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

from caris_desktop.domain.free_names import free_name
from caris_desktop.domain.translation import QT_TR_NOOP, LocalizedText, localized
from caris_desktop.recording.annotation.annotation_model import (
    Annotation,
    AnnotationDocument,
    Tier,
    Vocabulary,
    VocabularyEntry,
)

MOMENT_MS = 200
"""ELAN has stretches only: so long is what has no length."""
_LATEST_MS = 2**32 - 1
LONGEST_NAME = 100
LONGEST_VALUE = 10_000
_TAKEN = QT_TR_NOOP("The vocabulary {vocabulary} already exists. Choose another name.")
_NOT_IN_XML = re.compile("[^\t\n\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


class AnnotationError(Exception):
    """Refused edit, import or file, with the reason as user text; ``values`` fill its ``{names}``. The document is
    unchanged.
    """

    def __init__(self, text: str, **values: object) -> None:
        super().__init__(localized(text, **values))


def plain_text(text: str) -> str:
    """``text`` limited to characters that every annotation format can hold."""
    return _NOT_IN_XML.sub("\ufffd", text.replace("\r\n", "\n").replace("\r", "\n"))


# Tiers


def add_tier(
    document: AnnotationDocument, name: str, coder: str, vocabulary: str = "", *, participant: str = ""
) -> AnnotationDocument:
    """Add a tier of ``coder`` below the others; its id is :func:`next_tier_id`."""
    coder = _name(coder, QT_TR_NOOP("A coder needs a name."))
    name = _name(name, QT_TR_NOOP("A tier needs a name."))
    _refuse_taken_name(document, name, coder)
    if vocabulary:
        vocabulary_of(document, vocabulary)
    tier = Tier(next_tier_id(document, coder), name, coder, vocabulary, plain_text(participant))
    return replace(document, tiers=(*document.tiers, tier))


def rename_tier(document: AnnotationDocument, tier_id: str, name: str) -> AnnotationDocument:
    """Rename the tier to ``name``."""
    tier = _own_tier(document, tier_id)
    name = _name(name, QT_TR_NOOP("A tier needs a name."))
    if name != tier.name:
        _refuse_taken_name(document, name, tier.coder)
    return _with_tier(document, replace(tier, name=name))


def remove_tier(document: AnnotationDocument, tier_id: str) -> AnnotationDocument:
    """Remove the tier and its annotations."""
    _own_tier(document, tier_id)
    return document.only(lambda tier: tier.tier_id != tier_id)


def move_tier(document: AnnotationDocument, tier_id: str, position: int) -> AnnotationDocument:
    """Move the tier to index ``position`` of the timeline, from 0, clamped to the ends."""
    tier = _own_tier(document, tier_id)
    others = [item for item in document.tiers if item is not tier]
    position = min(max(position, 0), len(others))
    others.insert(position, tier)
    return sorted_document(replace(document, tiers=tuple(others)))


def set_tier_vocabulary(document: AnnotationDocument, tier_id: str, vocabulary: str) -> AnnotationDocument:
    """Bind the tier to ``vocabulary``; empty: free text."""
    tier = _own_tier(document, tier_id)
    if vocabulary:
        permitted = _values_of(vocabulary_of(document, vocabulary))
        for annotation in document.of_tier(tier_id):
            if annotation.value not in permitted:
                raise AnnotationError(
                    QT_TR_NOOP(
                        "{value} on the tier {tier} is not in the vocabulary {vocabulary}. Change that "
                        "annotation, or add the value to the vocabulary."
                    ),
                    value=quoted(annotation.value),
                    tier=quoted(tier.title),
                    vocabulary=quoted(vocabulary),
                )
    return _with_tier(document, replace(tier, vocabulary=vocabulary))


# Annotations


def add_annotation(
    document: AnnotationDocument, tier_id: str, start_ms: int, end_ms: int, value: str = ""
) -> AnnotationDocument:
    """Add an annotation; its id is :func:`next_annotation_id`."""
    tier = _own_tier(document, tier_id)
    annotation = Annotation(
        next_annotation_id(document, tier.coder), tier_id, start_ms, end_ms, _value(document, tier, value)
    )
    return _insert(document, tier, annotation)


def move_annotation(
    document: AnnotationDocument, annotation_id: str, start_ms: int, end_ms: int, tier_id: str | None = None
) -> AnnotationDocument:
    """Move the annotation to ``start_ms``..``end_ms``, and to the tier ``tier_id`` if given."""
    annotation = _own_annotation(document, annotation_id)
    tier = _own_tier(document, annotation.tier_id if tier_id is None else tier_id)
    if tier.tier_id != annotation.tier_id:
        if tier.coder != tier_of(document, annotation.tier_id).coder:
            raise AnnotationError(
                QT_TR_NOOP(
                    "The tier {tier} belongs to {coder}. An annotation cannot be moved to another coder's tier."
                ),
                tier=quoted(tier.title),
                coder=tier.coder,
            )
        _value(document, tier, annotation.value)
    moved = replace(annotation, tier_id=tier.tier_id, start_ms=start_ms, end_ms=end_ms)
    return _insert(_without(document, annotation_id), tier, moved)


def split_annotation(document: AnnotationDocument, annotation_id: str, at_ms: int) -> AnnotationDocument:
    """Split the annotation at ``at_ms`` into two of the same value; the second one gets :func:`next_annotation_id`."""
    annotation = _own_annotation(document, annotation_id)
    if not annotation.start_ms < at_ms < annotation.end_ms:
        raise AnnotationError(
            QT_TR_NOOP(
                "{time} is not inside the annotation ({start} to {end}). To split the annotation, choose a "
                "time inside it."
            ),
            time=time_text(at_ms),
            start=time_text(annotation.start_ms),
            end=time_text(annotation.end_ms),
        )
    tier = tier_of(document, annotation.tier_id)
    second = replace(
        annotation, annotation_id=next_annotation_id(document, tier.coder), start_ms=at_ms, end_ms=annotation.end_ms
    )
    first = replace(annotation, end_ms=at_ms)
    return _insert(_insert(_without(document, annotation_id), tier, first), tier, second)


def rename_annotation(document: AnnotationDocument, annotation_id: str, value: str) -> AnnotationDocument:
    """Set the annotation's value."""
    annotation = _own_annotation(document, annotation_id)
    tier = tier_of(document, annotation.tier_id)
    renamed = replace(annotation, value=_value(document, tier, value))
    return replace(
        document,
        annotations=tuple(renamed if item.annotation_id == annotation_id else item for item in document.annotations),
    )


def remove_annotation(document: AnnotationDocument, annotation_id: str) -> AnnotationDocument:
    """Remove the annotation."""
    _own_annotation(document, annotation_id)
    return _without(document, annotation_id)


def free_interval(document: AnnotationDocument, tier_id: str, start_ms: int, end_ms: int) -> tuple[int, int] | None:
    """The longest free part of the interval on the tier within the session; None if it is fully covered."""
    start_ms, end_ms = max(start_ms, 0), min(end_ms, document.duration_ms) if document.duration_ms else end_ms
    taken = [item for item in document.of_tier(tier_id) if item.end_ms > start_ms and item.start_ms < end_ms]
    begins_ms = [start_ms, *(item.end_ms for item in taken)]
    ends_ms = [*(item.start_ms for item in taken), end_ms]
    longest = max(zip(begins_ms, ends_ms, strict=True), key=lambda free: free[1] - free[0])
    return longest if longest[0] < longest[1] else None


# Vocabularies


def add_vocabulary(document: AnnotationDocument, vocabulary: Vocabulary) -> AnnotationDocument:
    """Add a vocabulary that tiers can use."""
    vocabulary = _plain_vocabulary(vocabulary)
    if any(item.name == vocabulary.name for item in document.vocabularies):
        raise AnnotationError(_TAKEN, vocabulary=quoted(vocabulary.name))
    return replace(document, vocabularies=(*document.vocabularies, vocabulary))


def change_vocabulary(
    document: AnnotationDocument, name: str, vocabulary: Vocabulary, *, renamed: Mapping[str, str] | None = None
) -> AnnotationDocument:
    """Replace the vocabulary ``name`` by ``vocabulary``, which may have another name.

    ``renamed`` maps old values to new ones; annotations of its tiers change with them. Values in use cannot be removed.
    """
    vocabulary_of(document, name)
    vocabulary = _plain_vocabulary(vocabulary)
    if vocabulary.name != name and any(item.name == vocabulary.name for item in document.vocabularies):
        raise AnnotationError(_TAKEN, vocabulary=quoted(vocabulary.name))
    tiers = {tier.tier_id: tier for tier in document.tiers if tier.vocabulary == name}
    permitted = _values_of(vocabulary)
    annotations = []
    for item in document.annotations:
        if item.tier_id in tiers:
            value = (renamed or {}).get(item.value, item.value)
            if value not in permitted:
                raise AnnotationError(
                    QT_TR_NOOP(
                        "{value} is used on the tier {tier} at {time}. Change that annotation first, or keep the value."
                    ),
                    value=quoted(value),
                    tier=quoted(tiers[item.tier_id].title),
                    time=time_text(item.start_ms),
                )
            item = replace(item, value=value) if value != item.value else item  # noqa: PLW2901 - the item as renamed
        annotations.append(item)
    return replace(
        document,
        tiers=tuple(
            replace(tier, vocabulary=vocabulary.name) if tier.tier_id in tiers else tier for tier in document.tiers
        ),
        vocabularies=tuple(vocabulary if item.name == name else item for item in document.vocabularies),
        annotations=tuple(annotations),
    )


# Lookup


def tier_of(document: AnnotationDocument, tier_id: str) -> Tier:
    """Tier with that id. Raises AnnotationError if there is none."""
    for tier in document.tiers:
        if tier.tier_id == tier_id:
            return tier
    raise AnnotationError(QT_TR_NOOP("That tier no longer exists."))


def annotation_of(document: AnnotationDocument, annotation_id: str) -> Annotation:
    """Annotation with that id. Raises AnnotationError if there is none."""
    for annotation in document.annotations:
        if annotation.annotation_id == annotation_id:
            return annotation
    raise AnnotationError(QT_TR_NOOP("That annotation no longer exists."))


def vocabulary_of(document: AnnotationDocument, name: str) -> Vocabulary:
    """Vocabulary with that name. Raises AnnotationError if there is none."""
    for vocabulary in document.vocabularies:
        if vocabulary.name == name:
            return vocabulary
    raise AnnotationError(QT_TR_NOOP("The vocabulary {name} does not exist."), name=quoted(name))


def annotation_at(document: AnnotationDocument, tier_id: str, at_ms: int) -> Annotation | None:
    """Annotation of the tier at that time; ``end_ms`` is exclusive."""
    return next((item for item in document.of_tier(tier_id) if item.start_ms <= at_ms < item.end_ms), None)


def next_tier_id(document: AnnotationDocument, coder: str) -> str:
    """Id of the next new tier of ``coder``."""
    return next_id(f"{id_part(coder)}-tier-", (tier.tier_id for tier in document.tiers))


def next_annotation_id(document: AnnotationDocument, coder: str) -> str:
    """Id of the next new annotation of ``coder``."""
    return next_id(f"{id_part(coder)}-", (item.annotation_id for item in document.annotations))


# Whole documents


def with_coders_called(document: AnnotationDocument, name_of: Callable[[str], str]) -> AnnotationDocument:
    """Rename each coder, including in the ids, which begin with the coder. ``name_of`` must be injective."""

    def renamed(identifier: str, coder: str) -> str:
        before, after = f"{id_part(coder)}-", f"{id_part(name_of(coder))}-"
        return after + identifier.removeprefix(before) if coder and identifier.startswith(before) else identifier

    coders = {tier.tier_id: tier.coder for tier in document.tiers}
    return replace(
        document,
        tiers=tuple(
            replace(tier, coder=name_of(tier.coder), tier_id=renamed(tier.tier_id, tier.coder))
            for tier in document.tiers
        ),
        annotations=tuple(
            replace(
                one,
                tier_id=renamed(one.tier_id, coders[one.tier_id]),
                annotation_id=renamed(one.annotation_id, coders[one.tier_id]),
            )
            for one in document.annotations
        ),
    )


def merge_documents(*documents: AnnotationDocument) -> AnnotationDocument:
    """Concatenate all tiers. Duplicate ids get a number; vocabularies of the same name are merged."""
    tiers: dict[str, Tier] = {}
    annotations: list[Annotation] = []
    taken: set[str] = set()
    vocabularies: dict[str, Vocabulary] = {}
    for document in documents:
        for vocabulary in document.vocabularies:
            first = vocabularies.setdefault(vocabulary.name, vocabulary)
            known = {entry.value for entry in first.entries}
            vocabularies[vocabulary.name] = replace(
                first,
                entries=(*first.entries, *(entry for entry in vocabulary.entries if entry.value not in known)),
                description=first.description or vocabulary.description,
            )
        new_ids = {}
        for tier in document.tiers:
            new_ids[tier.tier_id] = tier_id = free_name(tier.tier_id, "", tiers.__contains__)
            tiers[tier_id] = replace(tier, tier_id=tier_id)
        for item in document.annotations:
            annotation_id = free_name(item.annotation_id, "", taken.__contains__)
            taken.add(annotation_id)
            annotations.append(replace(item, annotation_id=annotation_id, tier_id=new_ids[item.tier_id]))
    return sorted_document(
        AnnotationDocument(
            tuple(tiers.values()),
            tuple(vocabularies.values()),
            tuple(annotations),
            max((document.duration_ms for document in documents), default=0),
        )
    )


def merge_imported(document: AnnotationDocument, imported: AnnotationDocument) -> AnnotationDocument:
    """Merge the coders' tiers of ``imported`` into ``document``; tiers derived from the recording are ignored.

    A tier exported from here (same coder and id) replaces the original. Others are appended; where their coder already
    has a tier of that name, names and ids get a number. Raises AnnotationError if there is nothing to import or it does
    not fit the session.
    """
    known = {(tier.coder, tier.tier_id) for tier in document.tiers}
    order = {tier.tier_id: number for number, tier in enumerate(document.tiers)}
    back = {tier.tier_id for tier in imported.tiers if tier.coder and (tier.coder, tier.tier_id) in known}
    rest = document.only(lambda tier: tier.tier_id not in back)
    tiers: list[Tier] = []
    for tier in imported.tiers:
        if tier.coder:
            taken = {other.name for other in (*rest.tiers, *tiers) if other.coder == tier.coder}
            tiers.append(replace(tier, name=free_name(tier.name, "", taken.__contains__, number_as=" ({})")))
    if not tiers:
        raise AnnotationError(QT_TR_NOOP("The file contains no coder's tiers, so nothing was imported."))
    used = {tier.vocabulary for tier in tiers}
    vocabularies = tuple(item for item in imported.vocabularies if item.name in used)
    coded = replace(imported.only(lambda tier: bool(tier.coder)), tiers=tuple(tiers), vocabularies=vocabularies)
    merged = merge_documents(rest, coded)
    merged = replace(
        merged,
        tiers=tuple(sorted(merged.tiers, key=lambda tier: order.get(tier.tier_id, len(order)))),
        duration_ms=document.duration_ms,
    )
    check_document(merged)
    return sorted_document(merged)


def tiers_of_coder(document: AnnotationDocument, coder: str) -> AnnotationDocument:
    """Only the tiers of ``coder``, with the vocabularies that no other coder uses."""
    mine = document.only(lambda tier: tier.coder == coder)
    theirs = {tier.vocabulary for tier in document.tiers if tier.coder != coder}
    theirs -= {tier.vocabulary for tier in mine.tiers}
    return replace(mine, vocabularies=tuple(item for item in document.vocabularies if item.name not in theirs))


def coders_of(document: AnnotationDocument) -> tuple[str, ...]:
    """All coders who have tiers, in timeline order."""
    return tuple(dict.fromkeys(tier.coder for tier in document.tiers if tier.coder))


def with_moments(annotations: Sequence[Annotation]) -> list[Annotation]:
    """Give point events a length: ``MOMENT_MS``, or less up to the next one on the tier."""
    starts: dict[str, list[int]] = {}
    for item in sorted(annotations, key=lambda item: item.start_ms):
        starts.setdefault(item.tier_id, []).append(item.start_ms)

    def end_ms(item: Annotation) -> int:
        if item.end_ms > item.start_ms:
            return item.end_ms
        later = starts[item.tier_id]
        at = bisect_right(later, item.start_ms)
        return min(item.start_ms + MOMENT_MS, later[at] if at < len(later) else _LATEST_MS)

    return [replace(item, end_ms=end_ms(item)) for item in annotations]


def sorted_document(document: AnnotationDocument) -> AnnotationDocument:
    """Document with sorted annotations."""
    key = _key(document)
    return replace(document, annotations=tuple(sorted(document.annotations, key=key)))


def check_document(document: AnnotationDocument) -> None:
    """Raise AnnotationError if a document breaks the rules, as one read from a file may."""
    tiers = {tier.tier_id: tier for tier in document.tiers}
    if len(tiers) < len(document.tiers):
        raise AnnotationError(QT_TR_NOOP("Two tiers have the same id."))
    if len({(tier.coder, tier.name) for tier in document.tiers}) < len(tiers):
        raise AnnotationError(QT_TR_NOOP("Two tiers of one coder have the same name."))
    values = {item.name: _values_of(item) for item in document.vocabularies}
    if len(values) < len(document.vocabularies):
        raise AnnotationError(QT_TR_NOOP("Two vocabularies have the same name."))
    for tier in document.tiers:
        if tier.vocabulary and tier.vocabulary not in values:
            raise AnnotationError(
                QT_TR_NOOP("The tier {tier} uses the vocabulary {vocabulary}, which does not exist."),
                tier=quoted(tier.title),
                vocabulary=quoted(tier.vocabulary),
            )
    if len({item.annotation_id for item in document.annotations}) < len(document.annotations):
        raise AnnotationError(QT_TR_NOOP("Two annotations have the same id."))
    ends: dict[str, int] = {}
    for item in sorted(document.annotations, key=lambda item: (item.tier_id, item.start_ms)):
        owner = tiers.get(item.tier_id)
        if owner is None:
            raise AnnotationError(
                QT_TR_NOOP("An annotation at {time} does not belong to a tier."), time=time_text(item.start_ms)
            )
        _refuse_times(document, item.start_ms, item.end_ms)
        if item.start_ms < ends.get(item.tier_id, 0):
            raise AnnotationError(
                QT_TR_NOOP("Two annotations on the tier {tier} overlap at {time}."),
                tier=quoted(owner.title),
                time=time_text(item.start_ms),
            )
        ends[item.tier_id] = item.end_ms
        if owner.vocabulary and item.value not in values[owner.vocabulary]:
            raise AnnotationError(
                QT_TR_NOOP("{value} on the tier {tier} is not in the vocabulary {vocabulary}."),
                value=quoted(item.value),
                tier=quoted(owner.title),
                vocabulary=quoted(owner.vocabulary),
            )


def time_text(at_ms: int) -> str:
    """``1:02:03.456``, or ``2:03.456`` in the first hour."""
    sign, at_ms = ("-", -at_ms) if at_ms < 0 else ("", at_ms)
    minutes, rest_ms = divmod(at_ms, 60_000)
    hours, minutes = divmod(minutes, 60)
    seconds = f"{rest_ms // 1000:02d}.{rest_ms % 1000:03d}"
    return f"{sign}{hours}:{minutes:02d}:{seconds}" if hours else f"{sign}{minutes}:{seconds}"


def _insert(document: AnnotationDocument, tier: Tier, annotation: Annotation) -> AnnotationDocument:
    _refuse_times(document, annotation.start_ms, annotation.end_ms)
    key = _key(document)
    items = list(document.annotations)
    at = bisect_left(items, key(annotation), key=key)
    for neighbour in items[max(at - 1, 0) : at + 1]:
        overlaps = neighbour.start_ms < annotation.end_ms and annotation.start_ms < neighbour.end_ms
        if neighbour.tier_id == tier.tier_id and overlaps:
            raise AnnotationError(
                QT_TR_NOOP(
                    "{value} is already on the tier {tier} ({start} to {end}). Annotations on the same tier "
                    "must not overlap: make the annotation shorter, or use another tier."
                ),
                value=quoted(neighbour.value),
                tier=quoted(tier.title),
                start=time_text(neighbour.start_ms),
                end=time_text(neighbour.end_ms),
            )
    insort(items, annotation, key=key)
    return replace(document, annotations=tuple(items))


def _refuse_times(document: AnnotationDocument, start_ms: int, end_ms: int) -> None:
    if end_ms <= start_ms:
        raise AnnotationError(
            QT_TR_NOOP("An annotation must end after it starts. Drag to the right, over an interval.")
        )
    if start_ms < 0:
        raise AnnotationError(QT_TR_NOOP("An annotation cannot start before the session does."))
    if document.duration_ms and end_ms > document.duration_ms:
        raise AnnotationError(
            QT_TR_NOOP("The session ends at {time}; an annotation cannot end after that."),
            time=time_text(document.duration_ms),
        )


def _refuse_taken_name(document: AnnotationDocument, name: str, coder: str) -> None:
    if any(tier.name == name and tier.coder == coder for tier in document.tiers):
        raise AnnotationError(
            QT_TR_NOOP("{coder} already has a tier {name}. Choose another name."), coder=coder, name=quoted(name)
        )


def _key(document: AnnotationDocument) -> Callable[[Annotation], tuple[int, int]]:
    order = {tier.tier_id: number for number, tier in enumerate(document.tiers)}
    return lambda item: (order[item.tier_id], item.start_ms)


def _own_tier(document: AnnotationDocument, tier_id: str) -> Tier:
    tier = tier_of(document, tier_id)
    if not tier.coder:
        raise AnnotationError(
            QT_TR_NOOP(
                "The tier {tier} is derived from the recording and cannot be changed. Add your own tier instead."
            ),
            tier=quoted(tier.title),
        )
    return tier


def _own_annotation(document: AnnotationDocument, annotation_id: str) -> Annotation:
    annotation = annotation_of(document, annotation_id)
    _own_tier(document, annotation.tier_id)
    return annotation


def _value(document: AnnotationDocument, tier: Tier, value: str) -> str:
    value = plain_text(value)
    if len(value) > LONGEST_VALUE:
        raise AnnotationError(
            QT_TR_NOOP("The text has %n characters; the maximum is {most}.", "", len(value)), most=LONGEST_VALUE
        )
    if tier.vocabulary and value not in _values_of(vocabulary_of(document, tier.vocabulary)):
        raise AnnotationError(
            QT_TR_NOOP(
                "{value} is not in the vocabulary {vocabulary}. Choose one of its values, or add it to the vocabulary."
            ),
            value=quoted(value),
            vocabulary=quoted(tier.vocabulary),
        )
    return value


def _name(name: str, refusal: str) -> str:
    name = " ".join(plain_text(name).split())
    if not name:
        raise AnnotationError(refusal)
    if len(name) > LONGEST_NAME:
        raise AnnotationError(
            QT_TR_NOOP("The name has %n characters; the maximum is {most}.", "", len(name)), most=LONGEST_NAME
        )
    return name


def _values_of(vocabulary: Vocabulary) -> set[str]:
    """The empty value is permitted too: an interval is often marked first and labelled later."""
    return {"", *(entry.value for entry in vocabulary.entries)}


def _plain_vocabulary(vocabulary: Vocabulary) -> Vocabulary:
    entries = tuple(
        VocabularyEntry(" ".join(plain_text(entry.value).split()), plain_text(entry.description))
        for entry in vocabulary.entries
    )
    values = [entry.value for entry in entries]
    if "" in values:
        raise AnnotationError(QT_TR_NOOP("A value of a vocabulary needs a name."))
    for value in values:
        if values.count(value) > 1:
            raise AnnotationError(
                QT_TR_NOOP("Duplicate value {value} in the vocabulary. Each value must be unique."), value=quoted(value)
            )
    return Vocabulary(
        _name(vocabulary.name, QT_TR_NOOP("A vocabulary needs a name.")), entries, plain_text(vocabulary.description)
    )


def _without(document: AnnotationDocument, annotation_id: str) -> AnnotationDocument:
    return replace(
        document, annotations=tuple(item for item in document.annotations if item.annotation_id != annotation_id)
    )


def _with_tier(document: AnnotationDocument, changed: Tier) -> AnnotationDocument:
    return replace(
        document, tiers=tuple(changed if tier.tier_id == changed.tier_id else tier for tier in document.tiers)
    )


def id_part(coder: str) -> str:
    """XML-safe id from a coder's name: letters, digits, hyphens, and no leading digit."""
    return "c-" + (re.sub(r"[^A-Za-z0-9]+", "-", coder).strip("-")[:30] or "coder")


def next_id(prefix: str, taken: Iterable[str]) -> str:
    """Next numbered id. It is higher than all present ones, so that an id keeps its meaning for people."""
    numbers = [item[len(prefix) :] for item in taken if item.startswith(prefix)]
    return f"{prefix}{max((int(number) for number in numbers if number.isascii() and number.isdigit()), default=0) + 1}"


def quoted(text: str) -> str:
    """Quote a text for messages: one line, shortened."""
    if isinstance(text, LocalizedText):
        return localized(QT_TR_NOOP("“{name}”"), name=text)
    text = " ".join(text.split())
    return f"“{text[:40]}…”" if len(text) > 41 else f"“{text}”"


Edit = Callable[[AnnotationDocument], AnnotationDocument]


class EditHistory:
    """Undo and redo of annotation edits; documents are immutable, so each step is a document.

    The edited document with its last ``limit`` states.
    """

    def __init__(self, document: AnnotationDocument, *, limit: int = 1000) -> None:
        self.document = document
        self._done: deque[AnnotationDocument] = deque(maxlen=limit)
        self._undone: list[AnnotationDocument] = []

    def apply(self, edit: Edit) -> AnnotationDocument:
        """Apply ``edit`` and return the new document.

        An exception of ``edit`` (AnnotationError if refused) changes nothing. An edit without an effect is not an undo
        step.
        """
        after = edit(self.document)
        if after != self.document:
            self._done.append(self.document)
            self._undone.clear()
            self.document = after
        return self.document

    @property
    def undo_step(self) -> str:
        """Source text of the step that ``undo`` reverts; empty if there is none."""
        return _step(self._done[-1], self.document) if self._done else ""

    @property
    def redo_step(self) -> str:
        return _step(self.document, self._undone[-1]) if self._undone else ""

    def undo(self) -> AnnotationDocument:
        """Undo one step, if any."""
        if self._done:
            self._undone.append(self.document)
            self.document = self._done.pop()
        return self.document

    def redo(self) -> AnnotationDocument:
        """Redo the last undone step, if any."""
        if self._undone:
            self._done.append(self.document)
            self.document = self._undone.pop()
        return self.document


def _step(before: AnnotationDocument, after: AnnotationDocument) -> str:
    if (before.tiers, before.vocabularies) != (after.tiers, after.vocabularies):
        return QT_TR_NOOP("change tiers")
    grown = len(after.annotations) - len(before.annotations)
    if grown:
        return QT_TR_NOOP("add annotation") if grown > 0 else QT_TR_NOOP("remove annotation")
    return QT_TR_NOOP("change annotation")
