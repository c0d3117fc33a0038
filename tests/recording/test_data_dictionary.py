"""The data dictionary explains every column: by more than its name, with one unit and one type for one name."""

import dataclasses
import re
import shutil
import typing
from pathlib import Path

from caris_desktop.domain.events import Marked
from caris_desktop.domain.sensing import StatusShown
from caris_desktop.domain.streams import STREAMS
from caris_desktop.recording.annotation.annotation_model import Annotation, AnnotationDocument, Tier
from caris_desktop.recording.annotation.annotation_store import save_coder
from caris_desktop.recording.data_dictionary import measure_rows
from caris_desktop.recording.measures.measure_definitions import MEASURES, THRESHOLDS
from caris_desktop.recording.measures.session_measures import measure, read_facts
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.tables.build import session_batches
from caris_desktop.recording.tables.catalog import tables_of
from caris_desktop.recording.tables.derived import ANNOTATIONS, DERIVED, SESSION_TABLE
from tests.recording.told_session import at, tell

TABLES = (
    SESSION_TABLE,
    *(one.table for one in DERIVED),
    ANNOTATIONS.table,
    *(table for spec in STREAMS for table in tables_of(spec)),
)
_WITHOUT_CONTENT = frozenset(re.split(" ", " a an the of in is are was were be been as at to on by for and or it id"))


def _words(text: str) -> set[str]:
    words = re.findall(r"[a-z0-9]+", text.lower())
    return {word.removesuffix("s") for word in words} - _WITHOUT_CONTENT


def _added_words(description: str, name: str) -> set[str]:
    return _words(description) - _words(name)


def test_a_repeated_name_is_found() -> None:
    assert not _added_words("The turn's id.", "turn_id")
    assert not _added_words("Person identified by.", "person_identified_by")
    assert _added_words("Utterance that was answered.", "turn_id")


def test_a_description_says_more_than_the_name() -> None:
    described = [(f"{table.name}.{column.name}", column) for table in TABLES for column in table.columns]
    described += [(measure.name, measure) for measure in MEASURES]
    repeated = [
        f"{where}: {one.description}"
        for where, one in described
        if len(_added_words(one.description, one.name) - _words(one.unit)) < 2
    ]
    assert repeated == []


def test_the_meaning_of_a_measure_without_a_value_is_given(tmp_path: Path) -> None:
    values = measure(read_facts(open_session(tell(tmp_path / "s", [], lasts_s=5.0)))).values
    described = {row["column"]: row["empty"] for row in measure_rows()}
    without = [name for name, value in values.items() if value is None and name in described]
    assert len(without) > 10
    assert [name for name in without if described[name] == "Never empty."] == []
    assert described["recorded_s"] == "Never empty."


def test_columns_of_one_name_have_one_unit() -> None:
    units: dict[str, set[str]] = {}
    for table in TABLES:
        for column in table.columns:
            units.setdefault(column.name, set()).add(column.unit)
    for one in (*MEASURES, *THRESHOLDS):
        units.setdefault(one.name, set()).add(one.unit)
    assert [name for name, found in units.items() if len(found) > 1] == []


def _may_be_empty() -> typing.Iterator[tuple[str, str]]:
    """Fields of recorded values that may be None, or text that is empty by default."""
    for spec in STREAMS:
        hints = typing.get_type_hints(spec.value_type)
        for field in dataclasses.fields(spec.value_type):
            optional = type(None) in typing.get_args(hints[field.name]) or field.default == ""
            if optional and not dataclasses.is_dataclass(hints[field.name]):
                yield spec.name.replace("/", "_"), field.name


def test_the_meaning_of_an_empty_cell_is_given() -> None:
    columns = {(table.name, column.field): column for table in TABLES for column in table.columns if column.field}
    missing = [key for key in _may_be_empty() if key in columns and not columns[key].empty]
    assert missing == []


def test_the_cells_of_a_recording_are_empty_only_where_that_has_a_meaning(tmp_path: Path) -> None:
    folder = tell(tmp_path / "s", [Marked(at(1.0), ""), StatusShown(at(1.0), "goal", None)], lasts_s=5.0)
    unnamed = AnnotationDocument((Tier("t", "Gaze", "Ann"),), (), (Annotation("a", "t", 0, 1000, ""),))
    save_coder(folder, unnamed, "Ann")
    (recorded,) = (Path(__file__).parents[2] / "examples" / "study" / "sessions").glob("*_P01")
    unexplained = {
        (table.name, column.name)
        for session in map(open_session, (folder, shutil.copytree(recorded, tmp_path / "recorded")))
        for table, cells in session_batches(session)
        for column, values in zip(table.columns, cells, strict=True)
        if not column.empty and any(value is None or (isinstance(value, str) and not value) for value in values)
    }
    assert unexplained == set()


def test_texts_of_a_fixed_set_list_their_values() -> None:
    listed = {(table.name, column.name): column.values for table in TABLES for column in table.columns}
    assert listed["drives", "source"] == ("keyboard", "gamepad", "onscreen", "rehearsal", "stop", "lease", "none")
    assert listed["suggestions", "fate"] == ("taken", "edited", "dismissed", "superseded", "expired")
    assert listed["event_guard_changed", "state"][:3] == ("absent", "clear", "slowing")
