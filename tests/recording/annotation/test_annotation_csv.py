"""Annotation tables of this program, of ELAN and of spreadsheets."""

from pathlib import Path

import pytest

from caris_desktop.recording.annotation import annotation_editing
from caris_desktop.recording.annotation.annotation_editing import AnnotationError
from caris_desktop.recording.annotation.annotation_import import read_csv
from caris_desktop.recording.annotation.annotation_model import AnnotationDocument, Vocabulary, VocabularyEntry
from caris_desktop.recording.annotation.annotation_store import save_coder
from caris_desktop.recording.session_export import ExportContext, export_session
from tests.recording.told_session import tell

ROWS = [("anna", "Gaze", 1000, 2500, "robot"), ("anna", "Gaze", 2500, 61_234, "away")]


def read(folder: Path, content: str | bytes, *, coder: str = "anna") -> list[tuple[str, str, int, int, str]]:
    path = folder / "x.csv"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    document = read_csv(path, coder=coder)
    annotation_editing.check_document(document)
    return [
        (tier.coder, tier.name, item.start_ms, item.end_ms, item.value)
        for tier in document.tiers
        for item in document.of_tier(tier.tier_id)
    ]


@pytest.mark.parametrize(
    "content",
    [
        "tier,start_ms,end_ms,value\nGaze,1000,2500,robot\nGaze,2500,61234,away\n",
        "tier,start,end,value\nGaze,1000,2500,robot\nGaze,2500,61234,away\n",
        "tier;start_s;end_s;value\r\nGaze;1;2,5;robot\r\n\r\nGaze;2,5;61,234;away\r\n",
        "tier,start_s,end_s,value\nGaze,1e+00,+2.5,robot\nGaze,2.50e+00,6.1234e+01,away\n",
        "sep=;\ntier;start_s;end_s;value\nGaze;1;2,5;robot\nGaze;2,5;61,234;away\n",
        "Tier,Start,End,Label\nGaze,1.0,2.5,robot\nGaze,2.5,61.234,away\n",
        "Tier\tBegin\tEnd\tText\nGaze\t00:00:01.000\t0:02.5\trobot\nGaze\t00:00:02.500\t00:01:01.234\taway\n",
        'value,tier,"end (ms)","start (ms)"\nrobot,Gaze,2500,1000\n"away",Gaze,61234,2500',
        # ELAN's tab-delimited text: with headings, with a column for each tier, and without headings.
        '"#file:///home/x/y.eaf"\nTier\tParticipant\tBegin Time - hh:mm:ss.ms\tBegin Time - ss.msec\t'
        "End Time - ss.msec\tDuration - msec\tAnnotation\nGaze\tP1\t00:00:01.000\t1.0\t2.5\t1500\trobot\n"
        "Gaze\tP1\t00:00:02.500\t2.5\t61.234\t58734\taway\n",
        "Begin Time - hh:mm:ss.ms\tEnd Time - hh:mm:ss.ms\tDuration - hh:mm:ss.ms\tGaze\n"
        "00:00:01.000\t00:00:02.500\t00:00:01.500\trobot\n00:00:02.500\t00:01:01.234\t00:00:58.734\taway\n",
        "Gaze\tP1\t00:00:01.000\t1.0\t1000\t00:00:02.500\t2.5\t2500\t00:00:01.500\t1.5\t1500\trobot\n"
        "Gaze\tP1\t00:00:02.500\t2.5\t2500\t00:01:01.234\t61.234\t61234\t00:00:58.734\t58.734\t58734\taway\n",
        "Gaze\t\t1.0\t2.5\t1.5\trobot\nGaze\t\t2.5\t61.234\t58.734\taway\n",
        "Gaze\t1000\t2500\trobot\nGaze\t2500\t61234\taway\n",
    ],
)
def test_tables_of_many_kinds_say_the_same(tmp_path: Path, content: str) -> None:
    assert read(tmp_path, content) == ROWS
    # Formats that Excel saves.
    assert read(tmp_path, content.encode("utf-8-sig")) == ROWS
    assert read(tmp_path, content.encode("utf-16")) == ROWS


def test_values_that_look_like_times_are_values(tmp_path: Path) -> None:
    assert read(tmp_path, "Count\t1.5\t2.25\t0.75\t3\nCount\t4.0\t5.0\t1.0\t4\n") == [
        ("anna", "Count", 1500, 2250, "3"),
        ("anna", "Count", 4000, 5000, "4"),
    ]
    assert read(tmp_path, "tier,start_s,end_s,value\nA,1,2,0:30\n") == [("anna", "A", 1000, 2000, "0:30")]


def test_coders_and_quoted_texts(tmp_path: Path) -> None:
    content = 'coder,tier,start_s,end_s,value\nben,T,0,1,"a ""b"",\nc"\n,T,0,1,Ünïcode \U0001f916\n'
    assert read(tmp_path, content) == [("ben", "T", 0, 1000, 'a "b",\nc'), ("anna", "T", 0, 1000, "Ünïcode \U0001f916")]
    assert read(tmp_path, "start_s;end_s;value\n1;2;Grüße".encode("cp1252")) == [
        ("anna", "Annotations", 1000, 2000, "Grüße")
    ]


def test_our_own_table_reads_back(tmp_path: Path) -> None:
    gaze = Vocabulary("Gaze", (VocabularyEntry("robot"), VocabularyEntry("away")))
    document = annotation_editing.add_vocabulary(AnnotationDocument(duration_ms=60_000), gaze)
    document = annotation_editing.add_tier(document, "Looks", "anna", "Gaze")
    document = annotation_editing.add_tier(document, "Notes", "anna")
    looks, notes = (tier.tier_id for tier in document.tiers)
    document = annotation_editing.add_annotation(document, looks, 1, 1234, "robot")
    document = annotation_editing.add_annotation(document, looks, 1234, 60_000, "away")
    document = annotation_editing.add_annotation(document, notes, 17, 18, 'He said "no";\nthen, <went>')
    folder = tell(tmp_path / "s", [], lasts_s=60.0)
    save_coder(folder, document, "anna")
    export_session(folder, "csv", tmp_path / "out", ExportContext(with_names=True))
    again = read_csv(tmp_path / "out" / "annotations.csv", coder="somebody")
    assert [(tier.name, tier.coder, tier.vocabulary) for tier in again.tiers] == [
        ("Looks", "anna", "Gaze"),
        ("Notes", "anna", ""),
    ]
    assert [(item.start_ms, item.end_ms, item.value) for item in again.annotations] == [
        (item.start_ms, item.end_ms, item.value) for item in document.annotations
    ]


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("", "The file is empty"),
        (b"\xff\xd8\xff\xe0\x00\x10JFIF", "The file is not a text file"),
        ("tier,start_s,end_s,value\nA,1,2,x\nA,1.5,x,y\n", "Line 3, end: “x” is not a valid time"),
        ("tier,start_s,end_s,value\nA,1,2,x\nA,3\n", "Line 3, end: the time is missing"),
        (
            "tier,start_s,end_s,value\nA,2,1,x\n",
            r"Line 2: the annotation ends \(1000 ms\) before it starts \(2000 ms\)",
        ),
        ("tier,start_s,end_s,value\nA,1,3,x\nB,1,3,x\nA,2,4,y\n", "Line 4 overlaps line 2 on the tier “A”"),
        ("tier,start_s,end_s,value\nA,-1,3,x\n", "Line 2, start: “-1” is not a valid time"),
        ("tier,start_s,end_s,value\nA,1,99999999,x\n", "is out of range for a session"),
        ("tier,start_s,value\nA,1,x\n", "the header has no column for the end"),
        ("tier,start_s,end_s\nA,1,2\n", "the header has no column for the value"),
        ("tier,start,end,value\nA,0,40,x\nA,60,110,x\n", "could be in seconds or milliseconds"),
        ('File type = "ooTextFile"\nObject class = "TextGrid"\n\nxmin = 0\n', "is a TextGrid of Praat"),
        ("talk.ordinal,talk.onset,talk.offset,talk.code\n1,1000,2000,a\n", "names no column for the start and the end"),
        ("just some\nlines of text\n", "there is no header row, and no column contains times"),
        ("tier,start_s,end_s,value\nA,1,2," + "x" * 20_000, "Line 2: a text is too long"),
        ("tier,start_s,end_s,value\nA,1,2," + "x" * 200_000, "Line 2: field larger"),
        ("tier,start_s,end_s,value\nA,1e3,2e3,x\n", "“1e3” is not a valid time"),
        ("tier,start_s,end_s,value\nA,1:2:3:4,9,x\n", "“1:2:3:4” is not a valid time"),
    ],
)
def test_an_unreadable_value_is_reported_with_its_line(tmp_path: Path, content: str | bytes, told: str) -> None:
    with pytest.raises(AnnotationError, match=told) as refusal:
        read(tmp_path, content)
    assert str(refusal.value).startswith("x.csv cannot be imported.")


def test_a_missing_file_is_reported(tmp_path: Path) -> None:
    with pytest.raises(AnnotationError, match="cannot be read"):
        read_csv(tmp_path / "none.csv")


_AGGREGATED = """\
Observation id,Observation date,Media file,Total length,FPS,Subject,Behavior,Behavioral category,Modifiers,\
Behavior type,Start (s),Stop (s),Duration (s),Comment start,Comment stop
obs1,2026-01-01 10:00:00,front.mp4,60,25.0,P1,looks at robot,,left,STATE,1.500,4.250,2.750,,
obs1,2026-01-01 10:00:00,front.mp4,60,25.0,P1,smiles,,,STATE,2.000,3.000,1.000,,
obs1,2026-01-01 10:00:00,front.mp4,60,25.0,P1,points,,,POINT,5.000,5.000,NA,,
obs1,2026-01-01 10:00:00,front.mp4,60,25.0,P1,points,,,POINT,5.100,5.100,NA,,
obs1,2026-01-01 10:00:00,front.mp4,60,25.0,P1,points,,,POINT,NA,NA,NA,,
obs2,2026-01-01 11:00:00,front.mp4,60,25.0,P1,points,,,POINT,9.000,9.000,NA,,
"""
_TABULAR = """\
Observation id\tobs1

Media file(s)\tfront.mp4

Time\tMedia file path\tTotal length\tFPS\tSubject\tBehavior\tBehavioral category\tModifiers\tComment\tStatus
1.500\tfront.mp4\t60\t25.0\tP1\tlooks at robot\t\tleft\t\tSTART
2.000\tfront.mp4\t60\t25.0\tP1\tsmiles\t\t\t\tSTART
3.000\tfront.mp4\t60\t25.0\tP1\tsmiles\t\t\t\tSTOP
4.250\tfront.mp4\t60\t25.0\tP1\tlooks at robot\t\tleft\t\tSTOP
5.000\tfront.mp4\t60\t25.0\tP1\tpoints\t\t\t\tPOINT
5.100\tfront.mp4\t60\t25.0\tP1\tpoints\t\t\t\tPOINT
8.000\tfront.mp4\t60\t25.0\tP1\tsmiles\t\t\t\tSTART
9.000\tfront.mp4\t60\t25.0\tP1\tlooks at robot\t\t\t\tSTOP
"""


@pytest.mark.parametrize(
    ("table", "left_out"),
    [
        (
            _AGGREGATED,
            ["Skipped rows without a time: 1.", "Skipped rows of another observation: 1."],
        ),
        (
            _TABULAR,
            ["Skipped rows with a stop but no start: 1.",
             "Skipped rows with a start but no stop: 1."],
        ),
    ],
)  # fmt: skip
def test_tables_of_boris_are_read_and_what_is_skipped_is_counted(
    tmp_path: Path, table: str, left_out: list[str]
) -> None:
    path = tmp_path / "boris.csv"
    path.write_text(table, encoding="utf-8")
    skipped: list[str] = []
    document = read_csv(path, coder="C1", skipped=skipped)
    names = {tier.tier_id: (tier.name, tier.participant, tier.coder) for tier in document.tiers}
    found = [(names[one.tier_id][0], one.start_ms, one.end_ms, one.value) for one in document.annotations]
    assert sorted(found) == [
        ("looks at robot", 1500, 4250, "looks at robot (left)"),
        ("points", 5000, 5100, "points"),
        ("points", 5100, 5300, "points"),
        ("smiles", 2000, 3000, "smiles"),
    ]
    assert set(names.values()) == {(name, "P1", "C1") for name in ("looks at robot", "points", "smiles")}
    assert skipped == left_out


def _boris(tmp_path: Path, *events: str) -> tuple[list[tuple[str, int, int, str]], list[str]]:
    path, skipped = tmp_path / "boris.csv", list[str]()
    head = "Observation id,Subject,Behavior,Modifier #1,Behavior type,"
    times = "Time" if any("START" in event for event in events) else "Start (s),Stop (s)"
    path.write_text("\n".join((head + times, *(f"obs1,P1,{event}" for event in events))), encoding="utf-8")
    document = read_csv(path, skipped=skipped)
    names = {tier.tier_id: tier.name for tier in document.tiers}
    return sorted((names[one.tier_id], one.start_ms, one.end_ms, one.value) for one in document.annotations), skipped


def test_states_of_boris_with_other_modifiers_are_other_states(tmp_path: Path) -> None:
    # The first one was never stopped.
    found, skipped = _boris(tmp_path, "points,left,START,1.0", "points,right,START,5.0", "points,right,STOP,6.0")
    assert found == [("points", 5000, 6000, "points (right)")]
    assert skipped == ["Skipped rows with a start but no stop: 1."]
    found, _ = _boris(
        tmp_path,
        "points,left,START,1.0", "points,right,START,2.0", "points,right,STOP,3.0", "points,left,STOP,4.0",
    )  # fmt: skip
    assert found == [
        ("points (left)", 1000, 4000, "points (left)"), ("points (right)", 2000, 3000, "points (right)"),
    ]  # fmt: skip


def test_a_state_of_boris_without_a_stop_is_no_moment(tmp_path: Path) -> None:
    found, skipped = _boris(tmp_path, "looks,,STATE,1.0,NA", "nods,,POINT,2.0,NA")
    assert found == [("nods", 2000, 2200, "nods")]
    assert skipped == ["Skipped rows with a start but no stop: 1."]


def test_a_quotation_mark_in_a_text_of_elan_swallows_no_line(tmp_path: Path) -> None:
    path = tmp_path / "elan.txt"
    path.write_text(
        "Tier\tBegin Time - msec\tEnd Time - msec\tAnnotation\n"
        'Talk\t1000\t2000\t"Hello\nTalk\t3000\t4000\tyou," he said\nTalk\t5000\t6000\t"Bye\n',
        encoding="utf-8",
    )
    found = [(one.start_ms, one.value) for one in read_csv(path).annotations]
    assert found == [(1000, '"Hello'), (3000, 'you," he said'), (5000, '"Bye')]


@pytest.mark.parametrize(
    ("cells", "moved_ms"),
    [
        ("/data/s1/video-front.mp4,60.0,0.0", 2500),
        ("1:video-front.mp4,,0", 2500),
        # A copy that begins with the session, as for ELAN; times that the coder aligned; another video
        ("video-front.mp4,62.5,0.0", 0),
        ("video-front.mp4,60.0,2.5", 0),
        ("other-video-front.mp4,60.0,0.0", 0),
    ],
)
def test_coding_of_a_video_in_boris_is_moved_to_the_session(tmp_path: Path, cells: str, moved_ms: int) -> None:
    path, skipped = tmp_path / "boris.csv", list[str]()
    path.write_text(
        "Media file name,Media duration (s),Time offset (s),Subject,Behavior,Behavior type,Start (s),Stop (s)\n"
        f"{cells},P1,looks,STATE,1.0,2.0\n",
        encoding="utf-8",
    )
    document = read_csv(path, skipped=skipped, media_spans_ms={"video-front.mp4": (2500, 62_500)})
    assert [one.start_ms for one in document.annotations] == [1000 + moved_ms]
    assert [one.end_ms for one in document.annotations] == [2000 + moved_ms]
    assert any("moved by 2.500 s: video-front.mp4" in note for note in skipped) is bool(moved_ms)


def test_an_annotation_without_length_is_a_moment(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("tier,start_ms,end_ms,value\nGaze,100,100,blink\nGaze,150,400,robot\nGaze,900,900,blink\n", "utf-8")
    document = read_csv(path, coder="C1")
    assert [(one.start_ms, one.end_ms) for one in document.annotations] == [(100, 150), (150, 400), (900, 1100)]
