"""Report and methods sheet: content, escaped markup, and independence of other files."""

import csv
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

from caris_desktop.domain.events import (
    AnswerUsed,
    ChatMessage,
    LlmExchange,
    Marked,
    PersonAppeared,
    PersonLeft,
    PhotoDeleted,
    PhotoTaken,
    PracticeEnded,
    Problem,
    RobotChosen,
    UtteranceChanged,
)
from caris_desktop.domain.streams import BY_NAME
from caris_desktop.recording.annotation.annotation_import import read_eaf
from caris_desktop.recording.annotation.annotation_model import Annotation, AnnotationDocument, Tier
from caris_desktop.recording.annotation.annotation_store import save_coder
from caris_desktop.recording.annotation.timeline_builder import build_overview
from caris_desktop.recording.exporters.methods import write_methods_of_study
from caris_desktop.recording.measures.session_measures import measure, read_facts
from caris_desktop.recording.session.session_reader import Session, open_session
from caris_desktop.recording.session_export import ExportContext, ExportRequest, export_all, export_session
from caris_desktop.recording.studies.statistics import study_statistics
from tests.recording.methods_sheets import sheet_of
from tests.recording.told_session import TRIAL, at, drive, exchange, heard, said, silenced, tell, tour

_VOID = {"meta", "img", "br", "hr", "input", "link"}
EVIL = '</title><script>alert("1")</script><img src=x onerror=alert(2)> & "quoted" \'single\''


class Page(HTMLParser):
    """HTML parser that fails on unclosed and wrongly nested elements."""

    def __init__(self, path: Path) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in _VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("style",):
            self.texts.append(" ".join(data.split()))

    @property
    def text(self) -> str:
        return " ".join(text for text in self.texts if text)

    def check_self_contained(self) -> None:
        assert not {tag for tag, _ in self.tags} & {"script", "iframe", "object", "link", "form"}
        for _, attributes in self.tags:
            assert not [name for name in attributes if name.startswith("on")]
            for name in ("src", "href"):
                assert (attributes.get(name) or "data:").startswith("data:")


@pytest.fixture(scope="module")
def toured(tmp_path_factory: pytest.TempPathFactory) -> Session:
    folder = tell(tmp_path_factory.mktemp("report") / "sessions" / "s1", tour(3, minutes=4), lasts_s=240)
    coded = AnnotationDocument((Tier("t", "Gaze", "Ann"),), (), (Annotation("x", "t", 2500, 9000, "at the robot"),))
    save_coder(folder, coded, "Ann")
    return open_session(folder)


def report_of(folder: Path, out: Path) -> Page:
    assert export_session(folder, "html", out) == [out / "report.html"]
    page = Page(out / "report.html")
    page.check_self_contained()
    return page


def drawings(page: Path) -> list[ElementTree.Element]:
    return [
        ElementTree.fromstring(svg)  # noqa: S314 - written by this program
        for svg in re.findall(r'<svg xmlns=.*?class="drawing[a-z ]*">.*?</svg>', page.read_text(encoding="utf-8"))
    ]


def test_the_report_shows_what_happened(toured: Session, tmp_path: Path) -> None:
    page = report_of(toured.folder, tmp_path / "out")
    measures = measure(read_facts(toured))
    for words in (
        "Participant P07, humour, trial 3",
        "21 November 2026, 10:00 UTC",
        "Simulated robot",
        "Tour guide",
        f"{len(measures.responses)}",
        "The recording was paused once, for 10.0 s in total.",
        "12 video frames are missing: the video encoder could not keep up.",
        "Wants to touch it & <try>.",
        "The robot does not respond. Driving has stopped.",
        "smollm2-135m, q8_0 (embedded, on this computer)",
        "Gaze",
        "emergency stop",
    ):
        assert words in page.text
    # In the transcript, and with its time as a tooltip of the timeline.
    fillers = measures.of("robot_utterances")["filler"]
    assert len([item for item in page.texts if item == "Let me think..."]) == fillers
    assert len([item for item in page.texts if re.fullmatch(r"\d:\d\d to \d:\d\d Let me think...", item)]) == fillers
    out = drawings(tmp_path / "out" / "report.html")
    titles = [drawing[0].text or "" for drawing in out]
    assert titles[:2] == ["Event log from 0:00 to 4:00", "Path of the robot on the map"]
    response_titles = [title for title in titles if title.startswith("Response time")]
    assert f"{len(measures.responses)} values" in response_titles[0]


def test_the_time_line_is_to_scale(toured: Session, tmp_path: Path) -> None:
    report_of(toured.folder, tmp_path / "out")
    line = drawings(tmp_path / "out" / "report.html")[0]
    space = "{http://www.w3.org/2000/svg}"
    plot = line.find(f"{space}rect[@class='plot']")
    assert plot is not None
    left_px, width_px = float(plot.get("x", "")), float(plot.get("width", ""))
    (coded,) = line.findall(f".//{space}rect[@class='coder']")
    assert float(coded.get("x", "")) == pytest.approx(left_px + width_px * 2.5 / 240, abs=0.02)
    assert float(coded.get("width", "")) == pytest.approx(width_px * 6.5 / 240, abs=0.02)
    (pause,) = line.findall(f".//{space}rect[@class='pause']")
    assert float(pause.get("x", "")) == pytest.approx(left_px + width_px * 210 / 240, abs=0.02)


def test_a_long_session_is_drawn_in_strips(tmp_path: Path) -> None:
    folder = tell(tmp_path / "s", [*heard(1, 10, 12, "Early"), *heard(2, 3000, 3002, "Late")], lasts_s=3300)
    report_of(folder, tmp_path / "out")
    every = drawings(tmp_path / "out" / "report.html")
    strips = [drawing for drawing in every if "Event log" in (drawing[0].text or "")]
    assert [drawing[0].text for drawing in strips] == [
        f"Event log from {begin} to {end}"
        for begin, end in (
            ("0:00", "10:00"), ("10:00", "20:00"), ("20:00", "30:00"), ("30:00", "40:00"), ("40:00", "50:00"),
            ("50:00", "55:00"),
        )
    ]  # fmt: skip
    assert ["Late" in "".join(drawing.itertext()) for drawing in strips] == [False] * 5 + [True]


@pytest.mark.logs(r"exporters\.html: ")
def test_no_utterance_becomes_markup(tmp_path: Path) -> None:
    values: list[Any] = [
        *heard(1, 1.0, 2.0, EVIL),
        *said(2, 2.5, 3.0, 4.0, EVIL),
        UtteranceChanged(at(5.0), "u", "robot", "half \ud83d and \x00 \x1b[31m", "typed", "started", detail=EVIL),
        Marked(at(6.0), EVIL, mark_id="m", note=EVIL),
        Marked(at(6.0), EVIL, "wizard_error", "e"),
        Problem(at(7.0), "error", EVIL, EVIL, EVIL),
        RobotChosen(at(0.0), "r", EVIL, "ws://"),
        exchange(1, 8.0, 9.0, EVIL, model=EVIL, messages=(ChatMessage("system", EVIL), ChatMessage("user", EVIL))),
        PhotoTaken(at(9.0), "front", 1, "../../../etc/passwd"),
        PhotoTaken(at(9.5), "front", 1, EVIL),
    ]
    folder = tell(tmp_path / "s", values, lasts_s=12, trial={"participant": EVIL, "wizard": EVIL, "condition": EVIL})
    page = report_of(folder, tmp_path / "out")
    assert EVIL in page.text
    assert "root:" not in page.text
    written = export_session(folder, "methods", tmp_path / "methods")
    sheet = Page(tmp_path / "methods" / "methods.html")
    sheet.check_self_contained()
    assert sorted(path.name for path in written) == ["methods.html", "methods.md"]
    markdown = (tmp_path / "methods" / "methods.md").read_text(encoding="utf-8")
    outside_the_appendix = re.sub(r"(?s)^```.*?^```", "", markdown, flags=re.MULTILINE)
    assert not re.search(r"(?<!\\)<", outside_the_appendix)
    assert EVIL in markdown


@pytest.mark.logs(r"exporters\.html: ")
def test_photos_are_in_the_page(tmp_path: Path) -> None:
    folder = tell(tmp_path / "s", [PhotoTaken(at(3.0), "front", 7, "photos/0001.png"),
                                   PhotoTaken(at(4.0), "front", 8, "photos/gone.png"),
                                   PhotoTaken(at(5.0), "front", 9, "photos/0003.png"),
                                   PhotoDeleted(at(6.0), "photos/gone.png"),
                                   PhotoDeleted(at(7.0), "photos/gone.png", restored=True),
                                   PhotoDeleted(at(8.0), "photos/0003.png")], lasts_s=10)  # fmt: skip
    (folder / "photos").mkdir()
    cv2.imwrite(str(folder / "photos" / "0001.png"), np.full((720, 1280, 3), (200, 40, 40), np.uint8))
    page = report_of(folder, tmp_path / "out")
    (photo,) = [attributes["src"] for tag, attributes in page.tags if tag == "img"]
    assert photo is not None
    assert photo.startswith("data:image/jpeg;base64,")
    assert "2 photos" in page.text
    assert "cannot be shown" in page.text


def test_an_empty_session_and_a_cut_one_have_a_report(tmp_path: Path) -> None:
    page = report_of(tell(tmp_path / "a", [], lasts_s=0.0, trial={}), tmp_path / "out-a")
    assert "The recording contains no utterances." in page.text
    assert "The robot reported neither odometry nor pose" in page.text
    page = report_of(tell(tmp_path / "b", heard(1, 1.0, 2.0, "Hi"), lasts_s=3.0, closed=False), tmp_path / "out-b")
    assert "The recording was cut off" in page.text


# Methods sheet


def test_speakers_through_the_robot_are_all_reported(tmp_path: Path) -> None:
    def decided(name: str, *actors: str) -> str:
        values = [
            replace(event, actor=actor)
            for number, actor in enumerate(actors, start=1)
            for event in said(number, 3.0 * number, 3.0 * number + 0.1, 3.0 * number + 1.0, f"Sentence {number}.")
        ]
        sheet = sheet_of([open_session(tell(tmp_path / name, values, lasts_s=30.0))])
        return sheet.answers["What did the robot do autonomously, and what did the wizard decide?"]

    # Versions 1 and 2 do not contain the actor.
    assert decided("alone", "wizard", "") == "The wizard decided what it said."
    assert decided("many", "wizard", "model", "console", "wizard:b", "model") == (
        "The wizard decided what it said, except for utterances by others"
        " (the language model: 2, the console: 1, another wizard: 1)."
    )


def paragraph(*values: Any, tmp_path: Path, lasts_s: float = 60.0, **trial: str) -> str:
    folder = tell(tmp_path / "sessions" / "s", list(values), lasts_s=lasts_s, trial={**TRIAL, **trial})
    return sheet_of([open_session(folder)]).paragraph


def test_the_sheet_names_where_each_answer_is_from_and_what_is_left_to_fill_in(toured: Session) -> None:
    sheet = sheet_of([toured])
    answers = sheet.items
    sources = {source for item in answers.values() for source in item.sources}
    assert {source for source in sources if not source.startswith(("session.json", "events.mcap"))} <= set(BY_NAME)
    for question, item in answers.items():
        assert item.answer or item.by_hand, question
        assert not item.answer or item.sources, question
    assert answers["Who were they?"].answer == ""
    assert answers["Where did it take place?"].by_hand
    assert "One wizard: Mia (one session)." in answers["How many wizards?"].answer
    measures = measure(read_facts(toured))
    (model,) = measures.models
    assert f"accepted {model.said + model.edited} " in answers["How many of its answers were used?"].answer
    assert "temperature 0.3" in answers["Which parameters were used?"].answer
    assert "+2.000 s from the computer's UTC" in answers["Which clocks were used, and how accurate were they?"].answer
    assert (
        "drifted by at most 50.4 ms per minute" in answers["Which clocks were used, and how accurate were they?"].answer
    )
    assert "12 video frames were not recorded." in answers["Which data is missing?"].answer
    (prompt,) = sheet.prompts
    assert prompt == "You are a friendly robot guide.\nAnswer in one short sentence."


def test_the_paragraph_for_nothing_at_all(tmp_path: Path) -> None:
    folder = tell(tmp_path / "s", [], lasts_s=30.0, trial={}, robot={})
    assert sheet_of([open_session(folder)]).paragraph == (
        "The robot ([robot]) was controlled by [number of] wizards with CARIS Desktop (version 0.test) in one session"
        " (30.0 s recorded). [Participants: age, gender, recruitment.] [Training of the wizard.]"
        " The robot was not driven. The wizard marked no errors of their own."
    )


def test_the_paragraph_for_one_of_each(tmp_path: Path) -> None:
    text = paragraph(
        RobotChosen(at(0), "tiago", "TIAGo", "ws://"),
        *heard(1, 1.0, 2.0, "Hi"),
        *said(1, 2.5, 3.0, 4.0, "Hello."),
        exchange(1, 5.0, 6.0, "Hello."),
        AnswerUsed(at(7), "x-1", "said", "Hello."),
        *drive(10.0, 12.0, 0.3),
        Marked(at(13), "slip", "wizard_error", "e"),
        tmp_path=tmp_path,
    )
    assert text == (
        "The robot (TIAGo) was controlled by one wizard with CARIS Desktop (version 0.test) in one session with one"
        " participant (1 min 00 s recorded). [Participants: age, gender, recruitment.] [Training of the wizard.]"
        " The robot made one utterance (100% typed by the wizard). The median time from the end of a participant's"
        " utterance to the robot's next words was 1.00 s (n = 1). The robot was driven manually for 2.0 s."
        " The language model smollm2-135m, q8_0 (embedded, on this computer; max_tokens 48, temperature 0.3) was asked"
        " once to propose what the robot could say; its answer was used unchanged by the wizard."
        " The wizard marked one error of their own (slip: 1; 10.0 per 10 minutes)."
    )


def test_an_answer_that_nobody_heard_is_used_nowhere(tmp_path: Path) -> None:
    values = [
        exchange(1, 5.0, 6.0, "Hello there."),
        *silenced(1, 7.0, "Hello there."),
        AnswerUsed(at(7.0), "x-1", "said", "Hello there.", "u-1"),
        PersonAppeared(at(8.0), "p-1", 1, 1),
        PersonAppeared(at(20.0), "p-2", 2, 2),
        PersonLeft(at(21.4), "p-1", 1),
        PersonAppeared(at(30.0), "p-3", 3, 3),
        PersonLeft(at(31.4), "p-2", 2),
    ]
    text = paragraph(*values, tmp_path=tmp_path)
    assert "its answer was not used by the wizard" in text
    assert "utterance" not in text
    session = open_session(tell(tmp_path / "told", values, lasts_s=60.0))
    answers = sheet_of([session]).answers
    assert (
        "accepted 0 (0%: 0 as they were, 0 edited), 0 dismissed, 1 not used"
        in (answers["How many of its answers were used?"])
    )
    assert answers["How many people were in front of the robot?"] == (
        "At most one person at once, as counted by the console: three identities from its detector and tracker, which "
        "may give one person several."
    )
    for fmt in ("html", "eaf", "frames", "csv", "vtt"):
        export_session(session.folder, fmt, tmp_path / fmt)
    page = next((tmp_path / "html").glob("*.html")).read_text(encoding="utf-8")
    assert "0 of 1 answer accepted" in page
    assert ">person at once<" in page.replace("\n", "")
    tiers = {tier.name for tier in read_eaf(tmp_path / "eaf" / "told.eaf").tiers}
    assert "Robot speech" not in tiers
    (used,) = [item.value for item in read_eaf(tmp_path / "eaf" / "told.eaf").of_tier("record-llm-answer-use")]
    assert used == "unheard"
    (turn,) = map(json.loads, (tmp_path / "frames" / "dialogue" / "turns.jsonl").read_text().splitlines())
    assert (turn["action"]["state"], turn["action"]["said"]) == ("interrupted", False)
    assert [moment.kind for moment in build_overview(session).moments] == []
    with (tmp_path / "csv" / "answers.csv").open(encoding="utf-8", newline="") as file:
        assert [(row["exchange_id"], row["use"]) for row in csv.DictReader(file)] == [("x-1", "unused")]
    with (tmp_path / "csv" / "utterances.csv").open(encoding="utf-8", newline="") as file:
        assert [row["said"] for row in csv.DictReader(file)] == ["false"]
    assert "Hello there." not in "".join(path.read_text() for path in (tmp_path / "vtt").glob("*.vtt"))


def test_an_answer_that_was_cut_off_is_reported_wherever_the_answer_is(tmp_path: Path) -> None:
    values = [
        exchange(1, 5.0, 6.0, "The lab closes at", cut="length"),
        exchange(2, 7.0, 8.0, "That is", cut="filter"),
        exchange(3, 9.0, 9.5, "Yes."),
        *said(1, 10.0, 10.5, 11.0, "It closes at six."),
    ]
    session = open_session(tell(tmp_path / "told", values, lasts_s=20.0))
    for fmt in ("html", "eaf", "frames", "csv"):
        export_session(session.folder, fmt, tmp_path / fmt)
    with (tmp_path / "csv" / "answers.csv").open(encoding="utf-8", newline="") as file:
        assert [row["cut"] for row in csv.DictReader(file)] == ["length", "filter", ""]
    page = Page(next((tmp_path / "html").glob("*.html")))
    assert "cut off at the length limit" in page.texts and "cut off by a filter" in page.texts
    tier = read_eaf(tmp_path / "eaf" / "told.eaf").of_tier("record-llm-exchanges")
    assert [one.value for one in tier] == ["The lab closes at (cut off)", "That is (cut off)", "Yes."]
    (turn,) = map(json.loads, (tmp_path / "frames" / "dialogue" / "turns.jsonl").read_text().splitlines())
    assert [one["cut"] for one in turn["context"]["assistant"]] == ["length", "filter", ""]


def test_the_paragraph_for_many(tmp_path: Path) -> None:
    exchanges: list[LlmExchange | AnswerUsed] = []
    for number in range(14):
        exchanges.append(exchange(number, number + 1.0, number + 1.5, "Yes.", model_version=""))
        if number < 3:
            exchanges.append(AnswerUsed(at(number + 1.6), f"x-{number}", "said" if number else "edited", "Yes."))
    exchanges[0] = replace(exchanges[0], parameters={"temperature": 0.9})
    text = paragraph(
        *exchanges,
        *(event for number in range(3) for event in heard(number, 20.0 + 4 * number, 21.0 + 4 * number, "Go")),
        *(event for number in range(3) for event in said(number, 22.0 + 4 * number, 22.1 + 4 * number, 23.0, "OK")),
        Marked(at(40), "slip", "wizard_error", "e1"),
        Marked(at(41), "late", "wizard_error", "e2"),
        Marked(at(42), "late", "wizard_error", "e3"),
        tmp_path=tmp_path,
        participant="",
    )  # fmt: skip
    assert "in one session (1 min 00 s recorded)" in text
    assert "was asked 14 times" in text
    assert "(embedded, on this computer; temperature 0.9; max_tokens 48, temperature 0.3)" in text
    assert "of its 14 answers, the wizard used three (21%, one of them edited)." in text
    assert "marked three errors of their own (late: 2, slip: 1; 30.0 per 10 minutes)" in text


def test_training_is_what_the_same_wizard_practised_before(tmp_path: Path) -> None:
    sessions_dir = tmp_path / "sessions"
    ended = PracticeEnded(1_000_000_000, done=9, steps=10, minutes=9.5, score=78)
    tell(sessions_dir / "p1", [ended], lasts_s=600, trial={"wizard": "Mia", "purpose": "practice"}, later_s=0)
    tell(sessions_dir / "p2", [], lasts_s=300, trial={"wizard": "mia ", "purpose": "Practice"}, later_s=3600)
    tell(sessions_dir / "p3", [], lasts_s=900, trial={"wizard": "Tom", "purpose": "practice"}, later_s=3600)
    tell(sessions_dir / "p4", [], lasts_s=900, trial={"wizard": "Mia", "purpose": "practice"}, later_s=90000)
    for number, wizard in enumerate(("Mia", "Mia", "Noor")):
        tell(sessions_dir / f"s{number}", heard(1, 1, 2, "Hi"), lasts_s=120, later_s=7200 + 3600 * number,
             trial={"wizard": wizard, "participant": f"P{number}", "condition": "AB"[number % 2]})  # fmt: skip
    one = sheet_of([open_session(sessions_dir / "s1")])
    assert "The wizard had practised with the program for 15 min 00 s before the first session." in one.paragraph
    out = tmp_path / "out"
    out.mkdir()
    everything = [open_session(folder) for folder in sorted(sessions_dir.iterdir())]
    steps: list[float] = []
    written = write_methods_of_study(everything, out, ExportContext(progress=steps.append))
    assert [path.name for path in written] == ["methods.md", "methods.html"]
    assert steps == sorted(steps)
    assert steps[-1] == 1.0
    text = (out / "methods.md").read_text(encoding="utf-8")
    assert "Mia: 15 min 00 s in two practice sessions, 78 of 100 points in the guided exercise." in text
    assert "No practice session was recorded for Noor." in text
    assert "Two wizards: Mia (two sessions) and Noor (one session)." in text
    assert "Three participants in three sessions." in text
    assert "A: 2, B: 1" in text
    assert "6 min 00 s in three sessions; 2 min 00 s each; four practice sessions were left out." in text
    assert "was controlled by two wizards with" in text
    assert "One of the two wizards had practised with the program for 15 min 00 s before the first session." in text
    page = Page(out / "methods.html")
    page.check_self_contained()


def test_the_place_of_a_language_model_is_its_server(tmp_path: Path) -> None:
    folder = tell(
        tmp_path / "s",
        [
            exchange(1, 1.0, 2.0, "Yes.", provider="ollama", server="127.0.0.1:11434", seed=7),
            exchange(2, 3.0, 4.0, "No.", provider="openai", server="gpu.example.org:8000"),
            exchange(3, 5.0, 6.0, "Hm.", provider="openai", model="old"),
        ],
        lasts_s=9,
    )
    out = tmp_path / "out"
    assert export_all(ExportRequest((folder,), ("html", "methods"), out, folder_per_session=False)).problems == ()
    for name in ("html/report.html", "methods/methods.md", "methods/methods.html"):
        text = (out / name).read_text(encoding="utf-8").replace("\\", "")
        for words in ("(ollama, on this computer", "(openai, at gpu.example.org:8000", "(openai, server not specified"):
            assert words in text, (name, words)
        assert "(openai)" not in text
    assert "1 of the 3 questions had a separate seed" in (out / "methods" / "methods.md").read_text(encoding="utf-8")
    made = study_statistics(tmp_path, tmp_path / "statistics")
    with (made.out / "models.csv").open(encoding="utf-8", newline="") as file:
        rows = [(row["provider"], row["server"], row["asked"], row["with_seed"]) for row in csv.DictReader(file)]
    assert rows == [
        ("ollama", "this computer", "1", "1"),
        ("openai", "not told", "1", "0"),
        ("openai", "gpu.example.org:8000", "1", "0"),
    ]
