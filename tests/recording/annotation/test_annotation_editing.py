"""Annotation edits: rules and undo."""

import dataclasses
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from caris_desktop.recording.annotation import annotation_editing
from caris_desktop.recording.annotation.annotation_editing import AnnotationError, EditHistory
from caris_desktop.recording.annotation.annotation_model import (
    Annotation,
    AnnotationDocument,
    Tier,
    Vocabulary,
    VocabularyEntry,
)
from tests.support.examples import examples

GAZE = Vocabulary("Gaze", (VocabularyEntry("robot", "at the robot"), VocabularyEntry("away")))
RECORD = AnnotationDocument(
    (Tier("record-motion", "Motion"),), (), (Annotation("r1", "record-motion", 0, 500, "forward"),), 10_000
)


def coded(*spans: tuple[int, int]) -> AnnotationDocument:
    """One tier of anna's with these annotations, in a session of ten seconds."""
    document = annotation_editing.add_tier(RECORD, "Gaze", "anna")
    for start_ms, end_ms in spans:
        document = annotation_editing.add_annotation(document, "c-anna-tier-1", start_ms, end_ms, "away")
    return document


def spans_of(document: AnnotationDocument, tier_id: str = "c-anna-tier-1") -> list[tuple[int, int]]:
    return [(item.start_ms, item.end_ms) for item in document.of_tier(tier_id)]


def test_annotations_of_a_tier_never_overlap() -> None:
    document = coded((1000, 2000), (2000, 3000))
    for start_ms, end_ms in ((500, 1001), (2999, 4000), (1200, 1300), (0, 9000), (1000, 2000)):
        with pytest.raises(AnnotationError, match="is already on the tier"):
            annotation_editing.add_annotation(document, "c-anna-tier-1", start_ms, end_ms, "x")
        assert annotation_editing.free_interval(document, "c-anna-tier-1", 1000, 3000) is None
    assert annotation_editing.free_interval(document, "c-anna-tier-1", 500, 4000) == (3000, 4000)
    assert annotation_editing.free_interval(document, "c-anna-tier-1", 0, 1500) == (0, 1000)
    assert annotation_editing.free_interval(document, "c-anna-tier-1", 9000, 99_000) == (9000, 10_000)
    moved = annotation_editing.move_annotation(document, "c-anna-1", 0, 2000)
    assert spans_of(moved) == [(0, 2000), (2000, 3000)]
    with pytest.raises(AnnotationError, match="is already on the tier"):
        annotation_editing.move_annotation(document, "c-anna-1", 0, 2001)


def test_times_lie_within_the_session() -> None:
    document = coded()
    for start_ms, end_ms, told in ((-1, 5, "before"), (9000, 10_001, "ends at 0:10.000"), (5, 5, "must end after")):
        with pytest.raises(AnnotationError, match=told):
            annotation_editing.add_annotation(document, "c-anna-tier-1", start_ms, end_ms, "x")
    assert spans_of(annotation_editing.add_annotation(document, "c-anna-tier-1", 0, 10_000, "x")) == [(0, 10_000)]


def test_a_vocabulary_limits_the_values_of_its_tiers() -> None:
    document = annotation_editing.add_vocabulary(coded(), GAZE)
    document = annotation_editing.add_tier(document, "Looks", "anna", "Gaze")
    document = annotation_editing.add_annotation(document, "c-anna-tier-2", 0, 10, "robot")
    # An empty value is permitted: coders mark first and label later.
    document = annotation_editing.add_annotation(document, "c-anna-tier-2", 20, 30, "")
    for refused in ("Robot", "robot ", "floor"):
        with pytest.raises(AnnotationError, match="is not in the vocabulary"):
            annotation_editing.rename_annotation(document, "c-anna-2", refused)
    with pytest.raises(AnnotationError, match="is used on the tier “Looks”"):
        annotation_editing.change_vocabulary(document, "Gaze", Vocabulary("Gaze", (VocabularyEntry("away"),)))
    changed = annotation_editing.change_vocabulary(
        document,
        "Gaze",
        Vocabulary("Looking", (VocabularyEntry("at robot"), VocabularyEntry("away"))),
        renamed={"robot": "at robot"},
    )
    assert [item.value for item in changed.of_tier("c-anna-tier-2")] == ["at robot", ""]
    assert annotation_editing.tier_of(changed, "c-anna-tier-2").vocabulary == "Looking"
    with pytest.raises(AnnotationError, match="The vocabulary “Gaze” already exists"):
        annotation_editing.add_vocabulary(document, GAZE)
    with pytest.raises(AnnotationError, match="Duplicate value"):
        annotation_editing.add_vocabulary(document, Vocabulary("New", (VocabularyEntry("a"), VocabularyEntry(" a"))))
    with pytest.raises(AnnotationError, match="is not in the vocabulary"):
        annotation_editing.set_tier_vocabulary(
            annotation_editing.add_annotation(document, "c-anna-tier-1", 0, 5, "?"), "c-anna-tier-1", "Gaze"
        )
    annotation_editing.check_document(changed)


def test_recorded_tiers_are_read_only() -> None:
    document = coded((0, 10))
    tried: list[Any] = [
        lambda: annotation_editing.add_annotation(document, "record-motion", 600, 700, "x"),
        lambda: annotation_editing.remove_annotation(document, "r1"),
        lambda: annotation_editing.rename_annotation(document, "r1", "x"),
        lambda: annotation_editing.split_annotation(document, "r1", 100),
        lambda: annotation_editing.move_annotation(document, "c-anna-1", 600, 700, "record-motion"),
        lambda: annotation_editing.rename_tier(document, "record-motion", "x"),
        lambda: annotation_editing.remove_tier(document, "record-motion"),
    ]
    for attempt in tried:
        with pytest.raises(AnnotationError, match="derived from the recording"):
            attempt()


def test_each_coder_has_tiers_and_names_of_their_own() -> None:
    document = annotation_editing.add_tier(coded((0, 10)), "Gaze", "ben")
    assert annotation_editing.coders_of(document) == ("anna", "ben")
    with pytest.raises(AnnotationError, match="ben already has a tier “Gaze”"):
        annotation_editing.add_tier(document, " Gaze ", "ben")
    with pytest.raises(AnnotationError, match="cannot be moved to another coder's tier"):
        annotation_editing.move_annotation(document, "c-anna-1", 0, 10, "c-ben-tier-1")
    with pytest.raises(AnnotationError, match="needs a name"):
        annotation_editing.add_tier(document, " \n", "ben")
    reordered = annotation_editing.move_tier(document, "c-ben-tier-1", 0)
    assert [tier.tier_id for tier in reordered.tiers] == ["c-ben-tier-1", "record-motion", "c-anna-tier-1"]
    assert annotation_editing.rename_tier(document, "c-ben-tier-1", "Looks").tiers[-1].name == "Looks"
    assert annotation_editing.remove_tier(document, "c-anna-tier-1").annotations == RECORD.annotations


def test_both_parts_of_a_split_annotation_keep_its_value() -> None:
    document = coded((1000, 2000), (4000, 5000))
    with pytest.raises(AnnotationError, match="is not inside"):
        annotation_editing.split_annotation(document, "c-anna-1", 1000)
    second = annotation_editing.next_annotation_id(document, "anna")
    split = annotation_editing.split_annotation(document, "c-anna-1", 1400)
    assert spans_of(split) == [(1000, 1400), (1400, 2000), (4000, 5000)]
    assert annotation_editing.annotation_of(split, second).value == "away"
    assert annotation_editing.annotation_of(split, "c-anna-1").value == "away"


def test_texts_are_what_xml_can_hold() -> None:
    document = annotation_editing.add_annotation(
        coded(), "c-anna-tier-1", 0, 10, "a\r\nb\rc\x00\x1b\ud800\ufffe \t<&>\U0001f916"
    )
    assert document.of_tier("c-anna-tier-1")[0].value == "a\nb\nc\ufffd\ufffd\ufffd\ufffd \t<&>\U0001f916"


def test_merging_documents_keeps_everything_apart() -> None:
    anna, ben = coded((0, 10), (20, 30)), coded((5, 15))
    merged = annotation_editing.merge_documents(anna, ben)
    assert len({tier.tier_id for tier in merged.tiers}) == 4
    assert len({item.annotation_id for item in merged.annotations}) == 5
    assert merged.duration_ms == 10_000
    third = Vocabulary("Gaze", (VocabularyEntry("floor"),))
    united = annotation_editing.merge_documents(
        AnnotationDocument(vocabularies=(GAZE,)), AnnotationDocument(vocabularies=(third,))
    )
    assert [entry.value for entry in united.vocabularies[0].entries] == ["robot", "away", "floor"]


def test_taking_over_leaves_the_record_out_and_loses_nothing() -> None:
    document = coded((0, 10))
    others = coded((0, 10), (20, 30))
    elsewhere = dataclasses.replace(
        others,
        tiers=tuple(dataclasses.replace(tier, tier_id=f"eaf-{tier.tier_id}") for tier in others.tiers),
        annotations=tuple(dataclasses.replace(item, tier_id=f"eaf-{item.tier_id}") for item in others.annotations),
    )
    taken = annotation_editing.merge_imported(document, elsewhere)
    assert [tier.name for tier in taken.tiers] == ["Motion", "Gaze", "Gaze (2)"]
    assert len(taken.annotations) == len(document.annotations) + 2
    # An exported annotation that was changed elsewhere replaces the original.
    both = annotation_editing.add_tier(document, "Below", "anna")
    assert annotation_editing.merge_imported(both, both) == both
    assert spans_of(annotation_editing.merge_imported(both, others)) == [(0, 10), (20, 30)]
    assert [tier.name for tier in annotation_editing.merge_imported(both, others).tiers] == ["Motion", "Gaze", "Below"]
    with pytest.raises(AnnotationError, match="no coder's tiers"):
        annotation_editing.merge_imported(document, RECORD)
    late = dataclasses.replace(coded(), duration_ms=0)
    late = annotation_editing.add_annotation(late, "c-anna-tier-1", 90_000, 91_000, "x")
    with pytest.raises(AnnotationError, match="The session ends at"):
        annotation_editing.merge_imported(document, late)


@settings(max_examples=examples(60), deadline=None)
@given(st.data())
def test_any_edits_keep_the_rules_and_can_be_undone(data: st.DataObject) -> None:
    """Invariants of random edits: rules hold, refusals change nothing, undo and redo restore the same states."""
    start = annotation_editing.add_tier(
        annotation_editing.add_vocabulary(coded((0, 400), (700, 900)), GAZE), "Looks", "anna", "Gaze"
    )
    history = EditHistory(start)
    states = [start]
    times = st.integers(-50, 10_050)
    values = st.sampled_from(["robot", "away", "", "floor", "nöch\n<b>"])
    for _ in range(data.draw(st.integers(1, 12))):
        document = history.document
        tier_id = data.draw(st.sampled_from([tier.tier_id for tier in document.tiers]))
        ids = st.sampled_from([item.annotation_id for item in document.annotations] or ["none"])
        edit = data.draw(
            st.one_of(
                st.tuples(st.just(annotation_editing.add_annotation), st.just(tier_id), times, times, values),
                st.tuples(
                    st.just(annotation_editing.move_annotation), ids, times, times, st.sampled_from([None, tier_id])
                ),
                st.tuples(st.just(annotation_editing.split_annotation), ids, times),
                st.tuples(st.just(annotation_editing.rename_annotation), ids, values),
                st.tuples(st.just(annotation_editing.remove_annotation), ids),
                st.tuples(st.just(annotation_editing.move_tier), st.just(tier_id), st.integers(-1, 4)),
                st.tuples(
                    st.just(annotation_editing.set_tier_vocabulary), st.just(tier_id), st.sampled_from(["", "Gaze"])
                ),
            )
        )
        function: Any = edit[0]
        arguments = edit[1:]
        try:
            history.apply(lambda document, function=function, arguments=arguments: function(document, *arguments))
        except AnnotationError as refusal:
            assert str(refusal).endswith(".")
            assert history.document is document
            continue
        annotation_editing.check_document(history.document)
        assert history.document == annotation_editing.sorted_document(history.document)
        if history.document != states[-1]:
            states.append(history.document)
    for state in reversed(states[:-1]):
        assert history.undo() == state
    assert history.undo() == start
    for state in states[1:]:
        assert history.redo() == state
    assert history.redo() == states[-1]


def test_history_is_bounded_and_a_new_edit_ends_what_could_be_done_again() -> None:
    history = EditHistory(coded(), limit=3)
    for number in range(5):
        history.apply(
            lambda document, at_ms=number * 100: annotation_editing.add_annotation(
                document, "c-anna-tier-1", at_ms, at_ms + 50, "x"
            )
        )
    last = history.document
    for _ in range(9):
        history.undo()
    assert len(history.document.of_tier("c-anna-tier-1")) == 2
    for _ in range(9):
        history.redo()
    assert history.document == last
    history.undo()
    history.apply(lambda document: annotation_editing.remove_annotation(document, "c-anna-1"))
    after = history.document
    assert history.redo() == after
