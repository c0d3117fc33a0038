"""Editing annotations: each function takes a document and gives the changed one, or says why that cannot be.

The rules are ELAN's: annotations of a tier do not overlap, a tier with a vocabulary holds its values only (or nothing
yet), times lie within the session. Tiers made from the record are read only. Texts are what XML can hold: other
control characters become U+FFFD, ends of lines become line feeds.
"""

import re
from bisect import bisect_left, insort
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

from caris_desktop.recording.annotation.model import (
    Annotation,
    AnnotationDocument,
    Tier,
    Vocabulary,
    VocabularyEntry,
)

LONGEST_NAME = 100
LONGEST_VALUE = 10_000
_NOT_IN_XML = re.compile("[^\t\n\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


class AnnotationError(Exception):
    """What cannot be done with annotations, and why; the text is for people. Nothing was changed."""


def plain_text(text: str) -> str:
    """``text`` as every format of annotations can hold it."""
    return _NOT_IN_XML.sub("\ufffd", text.replace("\r\n", "\n").replace("\r", "\n"))


# Tiers


def add_tier(
    document: AnnotationDocument, name: str, coder: str, vocabulary: str = "", *, participant: str = ""
) -> AnnotationDocument:
    """A new tier of ``coder`` below the others; its id is :func:`next_tier_id`."""
    coder = _name(coder, "A coder")
    name = _name(name, "A tier")
    _refuse_taken_name(document, name, coder)
    if vocabulary:
        vocabulary_of(document, vocabulary)
    tier = Tier(next_tier_id(document, coder), name, coder, vocabulary, plain_text(participant))
    return replace(document, tiers=(*document.tiers, tier))


def rename_tier(document: AnnotationDocument, tier_id: str, name: str) -> AnnotationDocument:
    """The tier is called ``name`` from now on."""
    tier = _own_tier(document, tier_id)
    name = _name(name, "A tier")
    if name != tier.name:
        _refuse_taken_name(document, name, tier.coder)
    return _with_tier(document, replace(tier, name=name))


def remove_tier(document: AnnotationDocument, tier_id: str) -> AnnotationDocument:
    """Without the tier and its annotations."""
    _own_tier(document, tier_id)
    return replace(
        document,
        tiers=tuple(tier for tier in document.tiers if tier.tier_id != tier_id),
        annotations=tuple(item for item in document.annotations if item.tier_id != tier_id),
    )


def move_tier(document: AnnotationDocument, tier_id: str, position: int) -> AnnotationDocument:
    """The tier becomes number ``position`` of the timeline, from 0; beyond the ends counts as the ends."""
    tier = _own_tier(document, tier_id)
    others = [item for item in document.tiers if item is not tier]
    position = min(max(position, 0), len(others))
    others.insert(position, tier)
    return sorted_document(replace(document, tiers=tuple(others)))


def set_tier_vocabulary(document: AnnotationDocument, tier_id: str, vocabulary: str) -> AnnotationDocument:
    """The tier holds values of ``vocabulary`` from now on; free text where that is empty."""
    tier = _own_tier(document, tier_id)
    if vocabulary:
        permitted = _values_of(vocabulary_of(document, vocabulary))
        for annotation in document.of_tier(tier_id):
            if annotation.value not in permitted:
                raise AnnotationError(
                    f"{_quoted(annotation.value)} on the tier {_quoted(tier.name)} is no value of the vocabulary "
                    f"{_quoted(vocabulary)}. Change that annotation, or add the value to the vocabulary."
                )
    return _with_tier(document, replace(tier, vocabulary=vocabulary))


# Annotations


def add_annotation(
    document: AnnotationDocument, tier_id: str, start_ms: int, end_ms: int, value: str = ""
) -> AnnotationDocument:
    """A new annotation; its id is :func:`next_annotation_id`."""
    tier = _own_tier(document, tier_id)
    annotation = Annotation(
        next_annotation_id(document, tier.coder), tier_id, start_ms, end_ms, _value(document, tier, value)
    )
    return _insert(document, tier, annotation)


def move_annotation(
    document: AnnotationDocument, annotation_id: str, start_ms: int, end_ms: int, tier_id: str | None = None
) -> AnnotationDocument:
    """The annotation lies from ``start_ms`` to ``end_ms``, on another tier where ``tier_id`` says so."""
    annotation = _own_annotation(document, annotation_id)
    tier = _own_tier(document, annotation.tier_id if tier_id is None else tier_id)
    if tier.tier_id != annotation.tier_id:
        if tier.coder != tier_of(document, annotation.tier_id).coder:
            raise AnnotationError(
                f"The tier {_quoted(tier.name)} is {tier.coder}'s. An annotation stays with the coder who made it."
            )
        _value(document, tier, annotation.value)
    moved = replace(annotation, tier_id=tier.tier_id, start_ms=start_ms, end_ms=end_ms)
    return _insert(_without(document, annotation_id), tier, moved)


def split_annotation(document: AnnotationDocument, annotation_id: str, at_ms: int) -> AnnotationDocument:
    """Two annotations of the same value that meet at ``at_ms``; the second one has the :func:`next_annotation_id`."""
    annotation = _own_annotation(document, annotation_id)
    if not annotation.start_ms < at_ms < annotation.end_ms:
        raise AnnotationError(
            f"{time_text(at_ms)} is not inside the annotation ({time_text(annotation.start_ms)} to "
            f"{time_text(annotation.end_ms)}). Choose a moment inside it to split it there."
        )
    tier = tier_of(document, annotation.tier_id)
    second = replace(
        annotation, annotation_id=next_annotation_id(document, tier.coder), start_ms=at_ms, end_ms=annotation.end_ms
    )
    first = replace(annotation, end_ms=at_ms)
    return _insert(_insert(_without(document, annotation_id), tier, first), tier, second)


def rename_annotation(document: AnnotationDocument, annotation_id: str, value: str) -> AnnotationDocument:
    """The annotation says ``value`` from now on."""
    annotation = _own_annotation(document, annotation_id)
    tier = tier_of(document, annotation.tier_id)
    renamed = replace(annotation, value=_value(document, tier, value))
    return replace(
        document,
        annotations=tuple(renamed if item.annotation_id == annotation_id else item for item in document.annotations),
    )


def remove_annotation(document: AnnotationDocument, annotation_id: str) -> AnnotationDocument:
    """Without the annotation."""
    _own_annotation(document, annotation_id)
    return _without(document, annotation_id)


def free_stretch(document: AnnotationDocument, tier_id: str, start_ms: int, end_ms: int) -> tuple[int, int] | None:
    """The longest part of the stretch that is free on the tier and within the session; None where nothing is."""
    start_ms, end_ms = max(start_ms, 0), min(end_ms, document.duration_ms) if document.duration_ms else end_ms
    best: tuple[int, int] | None = None
    at_ms = start_ms
    taken = [item for item in document.of_tier(tier_id) if item.end_ms > start_ms]
    for begin_ms, until_ms in [*((item.start_ms, item.end_ms) for item in taken), (end_ms, end_ms)]:
        free_until_ms = min(begin_ms, end_ms)
        if free_until_ms > at_ms and (best is None or free_until_ms - at_ms > best[1] - best[0]):
            best = (at_ms, free_until_ms)
        at_ms = max(at_ms, until_ms)
        if begin_ms >= end_ms:
            break
    return best


# Vocabularies


def add_vocabulary(document: AnnotationDocument, vocabulary: Vocabulary) -> AnnotationDocument:
    """A new vocabulary, which tiers can use from now on."""
    vocabulary = _plain_vocabulary(vocabulary)
    if any(item.name == vocabulary.name for item in document.vocabularies):
        raise AnnotationError(f"There is a vocabulary {_quoted(vocabulary.name)} already. Choose another name.")
    return replace(document, vocabularies=(*document.vocabularies, vocabulary))


def change_vocabulary(
    document: AnnotationDocument, name: str, vocabulary: Vocabulary, *, renamed: Mapping[str, str] | None = None
) -> AnnotationDocument:
    """The vocabulary ``name`` becomes ``vocabulary``, also under another name.

    ``renamed`` maps values of before to values of now; annotations of the tiers that use it change with them. Values
    that annotations still use cannot be taken out.
    """
    vocabulary_of(document, name)
    vocabulary = _plain_vocabulary(vocabulary)
    if vocabulary.name != name and any(item.name == vocabulary.name for item in document.vocabularies):
        raise AnnotationError(f"There is a vocabulary {_quoted(vocabulary.name)} already. Choose another name.")
    tiers = {tier.tier_id: tier for tier in document.tiers if tier.vocabulary == name}
    permitted = _values_of(vocabulary)
    annotations = []
    for item in document.annotations:
        if item.tier_id in tiers:
            value = (renamed or {}).get(item.value, item.value)
            if value not in permitted:
                raise AnnotationError(
                    f"{_quoted(value)} is used on the tier {_quoted(tiers[item.tier_id].name)} at "
                    f"{time_text(item.start_ms)}. Change that annotation first, or keep the value."
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


# Looking things up


def tier_of(document: AnnotationDocument, tier_id: str) -> Tier:
    """Raises AnnotationError where there is none."""
    for tier in document.tiers:
        if tier.tier_id == tier_id:
            return tier
    raise AnnotationError("That tier is not there any more.")


def annotation_of(document: AnnotationDocument, annotation_id: str) -> Annotation:
    """Raises AnnotationError where there is none."""
    for annotation in document.annotations:
        if annotation.annotation_id == annotation_id:
            return annotation
    raise AnnotationError("That annotation is not there any more.")


def vocabulary_of(document: AnnotationDocument, name: str) -> Vocabulary:
    """Raises AnnotationError where there is none."""
    for vocabulary in document.vocabularies:
        if vocabulary.name == name:
            return vocabulary
    raise AnnotationError(f"There is no vocabulary {_quoted(name)}.")


def annotation_at(document: AnnotationDocument, tier_id: str, at_ms: int) -> Annotation | None:
    """What the tier says at that moment; an annotation ends just before its ``end_ms``."""
    for annotation in document.of_tier(tier_id):
        if annotation.start_ms <= at_ms < annotation.end_ms:
            return annotation
    return None


def next_tier_id(document: AnnotationDocument, coder: str) -> str:
    """The id that the next new tier of ``coder`` gets."""
    return _next_id(f"{_id_part(coder)}-tier-", (tier.tier_id for tier in document.tiers))


def next_annotation_id(document: AnnotationDocument, coder: str) -> str:
    """The id that the next new annotation of ``coder`` gets."""
    return _next_id(f"{_id_part(coder)}-", (item.annotation_id for item in document.annotations))


# Whole documents


def with_coders_called(document: AnnotationDocument, name_of: Callable[[str], str]) -> AnnotationDocument:
    """The document with another name for each coder, in the ids too, which begin with it. ``name_of`` must give
    different coders different names.
    """

    def renamed(identifier: str, coder: str) -> str:
        before, after = f"{_id_part(coder)}-", f"{_id_part(name_of(coder))}-"
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
    """All tiers one below the other. Ids that occur twice get a number; vocabularies of one name are united."""
    tiers: dict[str, Tier] = {}
    annotations: list[Annotation] = []
    taken: set[str] = set()
    vocabularies: dict[str, Vocabulary] = {}
    for document in documents:
        for vocabulary in document.vocabularies:
            before = vocabularies.get(vocabulary.name)
            vocabularies[vocabulary.name] = vocabulary if before is None else _united(before, vocabulary)
        new_ids = {}
        for tier in document.tiers:
            new_ids[tier.tier_id] = tier_id = _untaken(tier.tier_id, tiers)
            tiers[tier_id] = replace(tier, tier_id=tier_id)
        for item in document.annotations:
            annotation_id = _untaken(item.annotation_id, taken)
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


def take_over(document: AnnotationDocument, imported: AnnotationDocument) -> AnnotationDocument:
    """``document`` with the coders' tiers of ``imported``; tiers from the record are not taken.

    A tier that came from here (its coder and its id are the same) takes the place of what it was. Others come below;
    where their coder has a tier of that name already, they get a number, and so do ids. Raises AnnotationError where
    there is nothing to take, or where it does not fit the session.
    """
    known = {(tier.coder, tier.tier_id) for tier in document.tiers}
    order = {tier.tier_id: number for number, tier in enumerate(document.tiers)}
    back = {tier.tier_id for tier in imported.tiers if tier.coder and (tier.coder, tier.tier_id) in known}
    rest = replace(
        document,
        tiers=tuple(tier for tier in document.tiers if tier.tier_id not in back),
        annotations=tuple(item for item in document.annotations if item.tier_id not in back),
    )
    tiers: list[Tier] = []
    taken = {(tier.coder, tier.name) for tier in rest.tiers}
    for tier in imported.tiers:
        if tier.coder:
            name, number = tier.name, 2
            while (tier.coder, name) in taken:
                name, number = f"{tier.name} ({number})", number + 1
            taken.add((tier.coder, name))
            tiers.append(replace(tier, name=name))
    if not tiers:
        raise AnnotationError("There are no tiers of a coder in it, so nothing was taken over.")
    mine = {tier.tier_id for tier in tiers}
    used = {tier.vocabulary for tier in tiers}
    coded = AnnotationDocument(
        tuple(tiers),
        tuple(item for item in imported.vocabularies if item.name in used),
        tuple(item for item in imported.annotations if item.tier_id in mine),
    )
    merged = merge_documents(rest, coded)
    merged = replace(
        merged,
        tiers=tuple(sorted(merged.tiers, key=lambda tier: order.get(tier.tier_id, len(order)))),
        duration_ms=document.duration_ms,
    )
    check_document(merged)
    return sorted_document(merged)


def tiers_of_coder(document: AnnotationDocument, coder: str) -> AnnotationDocument:
    """Only what ``coder`` made, with the vocabularies that nobody else uses."""
    mine = {tier.tier_id for tier in document.tiers if tier.coder == coder}
    theirs = {tier.vocabulary for tier in document.tiers if tier.coder != coder}
    used = {tier.vocabulary for tier in document.tiers if tier.coder == coder}
    return replace(
        document,
        tiers=tuple(tier for tier in document.tiers if tier.tier_id in mine),
        vocabularies=tuple(item for item in document.vocabularies if item.name in used or item.name not in theirs),
        annotations=tuple(item for item in document.annotations if item.tier_id in mine),
    )


def coders_of(document: AnnotationDocument) -> tuple[str, ...]:
    """Everybody who has tiers, in the order of the timeline."""
    return tuple(dict.fromkeys(tier.coder for tier in document.tiers if tier.coder))


def sorted_document(document: AnnotationDocument) -> AnnotationDocument:
    """The same with its annotations in order."""
    key = _key(document)
    return replace(document, annotations=tuple(sorted(document.annotations, key=key)))


def check_document(document: AnnotationDocument) -> None:
    """Raises AnnotationError where a document breaks the rules, as one that was read from a file may."""
    tiers = {tier.tier_id: tier for tier in document.tiers}
    if len(tiers) < len(document.tiers):
        raise AnnotationError("Two tiers have the same id.")
    if len({(tier.coder, tier.name) for tier in document.tiers}) < len(tiers):
        raise AnnotationError("Two tiers of one coder have the same name.")
    values = {item.name: _values_of(item) for item in document.vocabularies}
    if len(values) < len(document.vocabularies):
        raise AnnotationError("Two vocabularies have the same name.")
    for tier in document.tiers:
        if tier.vocabulary and tier.vocabulary not in values:
            raise AnnotationError(
                f"The tier {_quoted(tier.name)} uses the vocabulary {_quoted(tier.vocabulary)}, which is not there."
            )
    if len({item.annotation_id for item in document.annotations}) < len(document.annotations):
        raise AnnotationError("Two annotations have the same id.")
    ends: dict[str, int] = {}
    for item in sorted(document.annotations, key=lambda item: (item.tier_id, item.start_ms)):
        owner = tiers.get(item.tier_id)
        if owner is None:
            raise AnnotationError(f"An annotation at {time_text(item.start_ms)} belongs to no tier.")
        _refuse_times(document, item.start_ms, item.end_ms)
        if item.start_ms < ends.get(item.tier_id, 0):
            raise AnnotationError(
                f"Two annotations of the tier {_quoted(owner.name)} overlap at {time_text(item.start_ms)}."
            )
        ends[item.tier_id] = item.end_ms
        if owner.vocabulary and item.value not in values[owner.vocabulary]:
            raise AnnotationError(
                f"{_quoted(item.value)} on the tier {_quoted(owner.name)} is no value of the vocabulary "
                f"{_quoted(owner.vocabulary)}."
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
                f"{_quoted(neighbour.value)} lies there already on the tier {_quoted(tier.name)} "
                f"({time_text(neighbour.start_ms)} to {time_text(neighbour.end_ms)}). Annotations of one tier do not "
                "overlap: make it shorter, or use another tier."
            )
    insort(items, annotation, key=key)
    return replace(document, annotations=tuple(items))


def _refuse_times(document: AnnotationDocument, start_ms: int, end_ms: int) -> None:
    if end_ms <= start_ms:
        raise AnnotationError("An annotation ends after it starts. Drag it to the right, over a stretch of time.")
    if start_ms < 0:
        raise AnnotationError("An annotation cannot start before the session does.")
    if document.duration_ms and end_ms > document.duration_ms:
        raise AnnotationError(f"The session ends at {time_text(document.duration_ms)}; no annotation lies after that.")


def _refuse_taken_name(document: AnnotationDocument, name: str, coder: str) -> None:
    if any(tier.name == name and tier.coder == coder for tier in document.tiers):
        raise AnnotationError(f"{coder} has a tier {_quoted(name)} already. Choose another name.")


def _key(document: AnnotationDocument) -> Callable[[Annotation], tuple[int, int]]:
    order = {tier.tier_id: number for number, tier in enumerate(document.tiers)}
    return lambda item: (order[item.tier_id], item.start_ms)


def _own_tier(document: AnnotationDocument, tier_id: str) -> Tier:
    tier = tier_of(document, tier_id)
    if not tier.coder:
        raise AnnotationError(
            f"The tier {_quoted(tier.name)} is made from the record and stays as it is. Add a tier of your own for it."
        )
    return tier


def _own_annotation(document: AnnotationDocument, annotation_id: str) -> Annotation:
    annotation = annotation_of(document, annotation_id)
    _own_tier(document, annotation.tier_id)
    return annotation


def _value(document: AnnotationDocument, tier: Tier, value: str) -> str:
    value = plain_text(value)
    if len(value) > LONGEST_VALUE:
        raise AnnotationError(f"A text of {len(value)} characters is too long; {LONGEST_VALUE} fit.")
    if tier.vocabulary and value not in _values_of(vocabulary_of(document, tier.vocabulary)):
        raise AnnotationError(
            f"{_quoted(value)} is no value of the vocabulary {_quoted(tier.vocabulary)}. Choose one of its values, or "
            "add it to the vocabulary."
        )
    return value


def _name(name: str, what: str) -> str:
    name = " ".join(plain_text(name).split())
    if not name:
        raise AnnotationError(f"{what} needs a name.")
    if len(name) > LONGEST_NAME:
        raise AnnotationError(f"A name of {len(name)} characters is too long; {LONGEST_NAME} fit.")
    return name


def _values_of(vocabulary: Vocabulary) -> set[str]:
    """Nothing at all is permitted too: a stretch is often marked first and named later."""
    return {"", *(entry.value for entry in vocabulary.entries)}


def _plain_vocabulary(vocabulary: Vocabulary) -> Vocabulary:
    entries = tuple(
        VocabularyEntry(" ".join(plain_text(entry.value).split()), plain_text(entry.description))
        for entry in vocabulary.entries
    )
    values = [entry.value for entry in entries]
    if "" in values:
        raise AnnotationError("A value of a vocabulary needs a name.")
    for value in values:
        if values.count(value) > 1:
            raise AnnotationError(f"{_quoted(value)} is twice in the vocabulary. Each value stands there once.")
    return Vocabulary(_name(vocabulary.name, "A vocabulary"), entries, plain_text(vocabulary.description))


def _united(first: Vocabulary, second: Vocabulary) -> Vocabulary:
    known = {entry.value for entry in first.entries}
    return replace(
        first,
        entries=(*first.entries, *(entry for entry in second.entries if entry.value not in known)),
        description=first.description or second.description,
    )


def _without(document: AnnotationDocument, annotation_id: str) -> AnnotationDocument:
    return replace(
        document, annotations=tuple(item for item in document.annotations if item.annotation_id != annotation_id)
    )


def _with_tier(document: AnnotationDocument, changed: Tier) -> AnnotationDocument:
    return replace(
        document, tiers=tuple(changed if tier.tier_id == changed.tier_id else tier for tier in document.tiers)
    )


def _id_part(coder: str) -> str:
    """Ids are those of XML too: letters, digits, hyphens, and no digit first."""
    return "c-" + (re.sub(r"[^A-Za-z0-9]+", "-", coder).strip("-")[:30] or "coder")


def _next_id(prefix: str, taken: Iterable[str]) -> str:
    """Numbers are not used again while a higher one is there, so that an id keeps its meaning in the eyes of people."""
    numbers = [item[len(prefix) :] for item in taken if item.startswith(prefix)]
    return f"{prefix}{max((int(number) for number in numbers if number.isascii() and number.isdigit()), default=0) + 1}"


def _untaken(name: str, taken: Iterable[str]) -> str:
    taken = taken if isinstance(taken, (set, dict)) else set(taken)
    candidate, number = name, 2
    while candidate in taken:
        candidate, number = f"{name}-{number}", number + 1
    return candidate


def _quoted(text: str) -> str:
    """As messages show it: one line, not too long."""
    text = " ".join(text.split())
    return f"“{text[:40]}…”" if len(text) > 41 else f"“{text}”"
