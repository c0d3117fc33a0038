"""People panel: present, past and known people, and the wizard's identity decisions."""

import dataclasses
from collections.abc import Iterator

import pytest
from PySide6.QtCore import QEvent, QPoint, QRect, Qt
from PySide6.QtGui import QPainter, QPixmap
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QLineEdit
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.events import PersonIdentified, PersonRenamed
from caris_desktop.live.state import LiveState, PresentClock
from caris_desktop.live.status import LoadStatus, PerceptionStatus
from caris_desktop.people.presence import PersonRow, Suggestion
from caris_desktop.scenario.scenario_model import Permissions
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.people_panel import PeoplePanel, UndoBar
from caris_desktop.ui.people.people_list import CAPTION_PX, ROW_PX, PeopleModel
from caris_desktop.ui.people.portraits import PortraitPixmaps
from caris_desktop.ui.people.shown_people import (
    TO_READ_NS,
    IdentityQuestion,
    direction,
    found,
    next_asked,
    what_is_seen,
)
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from tests.ui import people_samples, samples
from tests.ui.conftest import MemorySettings, click, find, open_window
from tests.ui.fake_console import FakeConsole

pytestmark = pytest.mark.panels("people")

CTRL, SHIFT = Qt.KeyboardModifier.ControlModifier, Qt.KeyboardModifier.ShiftModifier


@pytest.fixture
def panel(window: MainWindow, console: FakeConsole) -> Iterator[PeoplePanel]:
    found = window.panels["people"]
    assert isinstance(found, PeoplePanel)
    people_samples.show_people(console, people_samples.people_of_a_tour())
    console.calls.clear()
    yield found


def test_slow_embeddings_are_called_late_instead_of_nobody(panel: PeoplePanel, console: FakeConsole) -> None:
    state = console.state
    people_samples.show_people(console, ())
    state.everybody.set(())
    for perception, fact in (
        (PerceptionStatus("ready", "yolov8n", inference_ms=300.0, looks_per_s={"front": 3.0}), "nobody here"),
        (PerceptionStatus("ready", "yolov8n", inference_ms=2300.0, looks_per_s={"front": 0.4}), "2 s behind"),
        (PerceptionStatus("ready", "yolov8n", inference_ms=300.0, looks_per_s={"front": 0.25}), "4 s behind"),
    ):
        state.camera.set("front")
        state.perception.set(perception)
        assert fact in panel.fact[0]
        late = "behind" in fact
        assert panel.fact[1] == ("amber" if late else "dim")
        empty = find(panel, "people_empty").property("text")
        assert ("s behind" in empty, "Nobody in view" in empty) == (late, not late)
    people_samples.show_people(console, people_samples.people_of_a_tour())
    assert "4 here" in panel.fact[0] and "4 s behind" in panel.fact[0]


def test_before_the_first_detection_it_does_not_say_that_nobody_is_there(
    panel: PeoplePanel, console: FakeConsole
) -> None:
    people_samples.show_people(console, ())
    console.state.everybody.set(())
    console.state.perception.set(PerceptionStatus("ready", "yolov8n"))
    empty = str(find(panel, "people_empty").property("text"))
    assert empty.startswith("Person detection is starting") and "nobody" not in panel.fact[0]
    console.state.perception.set(PerceptionStatus("ready", "yolov8n", inference_ms=300.0))
    assert "Nobody in view" in str(find(panel, "people_empty").property("text"))


def names(panel: PeoplePanel) -> list[str]:
    return [str(panel.model.index(row).data()) for row in range(panel.model.rowCount())]


def told(panel: PeoplePanel, person_id: str) -> str:
    row = panel.model.row_of(person_id)
    assert row is not None
    return str(panel.model.index(row).data(Qt.ItemDataRole.AccessibleTextRole))


def press(qtbot: QtBot, panel: PeoplePanel, person_id: str, act: str) -> None:
    """Click a button of the row, or with "pick" the row itself."""
    row = panel.model.row_of(person_id)
    assert row is not None
    panel.list.scrollTo(panel.model.index(row))
    controls = panel.list.controls[person_id]
    if act == "pick":
        qtbot.mouseClick(controls, Qt.MouseButton.LeftButton, pos=QPoint(70, 20))
    else:
        click(qtbot, find(controls, f"person_{act}"))


def unfold(panel: PeoplePanel) -> None:
    """Show the people who left without a name, too."""
    button = panel.window().findChild(ActionButton, "people_unfold")
    assert button is not None
    assert not button.isHidden()
    button.click()


# Displayed rows


def test_people_who_left_without_a_name_are_counted_and_shown_on_request(
    panel: PeoplePanel, console: FakeConsole
) -> None:
    left = [row for row in console.state.everybody.value if row.person_id == "p-5"]
    many = [dataclasses.replace(left[0], person_id=f"p-left-{n}", name=f"Person {n}", number=n) for n in range(40, 70)]
    named = dataclasses.replace(left[0], person_id="p-eva", name="Eva")
    console.state.everybody.set((*console.state.everybody.value, *many, named))
    assert [name for name in names(panel) if name.startswith("Person")] == ["Person 3", "Person 4"]
    assert panel.model.captions[4] == "Was here · 1", "of whom something is known"
    button = panel.window().findChild(ActionButton, "people_unfold")
    assert button is not None
    assert (button.text(), button.toolTip()) == ("+ 31 left", "Show 31 who left without a name")
    unfold(panel)
    assert len([name for name in names(panel) if name.startswith("Person")]) == 2 + 31
    unfold(panel)
    console.state.selected_person.set("p-left-41")
    panel.update_view()
    assert "Person 41" in names(panel), "with whom the wizard deals"
    console.state.everybody.set(())
    assert button.isHidden()


def test_of_two_suggestions_one_is_asked_about(panel: PeoplePanel, console: FakeConsole) -> None:
    rows = console.state.persons.value
    asked = next(row for row in rows if row.person_id == "p-3")
    two = tuple(
        dataclasses.replace(row, suggestions=asked.suggestions) if row.person_id == "p-4" else row for row in rows
    )
    console.state.persons.set(two)
    assert "Maybe Mara" in told(panel, "p-3")
    assert "Maybe" not in told(panel, "p-4")
    row = panel.model.row_of("p-4")
    assert row is not None
    assert [button.act for button in panel.list.buttons(row)] == ["name", "card"]
    console.state.selected_person.set("p-4")
    assert "Maybe Mara" in told(panel, "p-4")
    assert "Maybe" not in told(panel, "p-3")


@pytest.mark.parametrize("pointed", [0, 2, 3])
def test_no_row_moves_under_the_pointer(qtbot: QtBot, panel: PeoplePanel, console: FakeConsole, pointed: int) -> None:
    panel.list.scrollToTop()
    before = names(panel)
    at = panel.list.row_rect(pointed).center()
    qtbot.mouseMove(panel.list.viewport(), at)
    place = panel.list.row_rect(pointed)
    rows = console.state.persons.value
    new = [dataclasses.replace(rows[3], person_id=f"p-new-{n}", name=f"Person 2{n}", since_ns=n + 1) for n in range(3)]
    console.state.persons.set((*new, *rows[1:]))  # the first has left; three people were present for longer
    assert names(panel)[: pointed + 1] == before[: pointed + 1]
    assert panel.list.row_rect(pointed) == place
    assert {"Person 20", "Person 21", "Person 22"} <= set(names(panel)[pointed + 1 : pointed + 7]), "in view at once"
    QApplication.sendEvent(panel.list.viewport(), QEvent(QEvent.Type.Leave))
    assert names(panel)[:3] == ["Person 20", "Person 21", "Person 22"]
    # The pointer keeps its position after the test.
    qtbot.mouseMove(panel.window(), QPoint(1, 1))


@pytest.mark.panels()
def test_while_a_name_is_typed_row_and_box_are_lit(
    qtbot: QtBot, window: MainWindow, panel: PeoplePanel, console: FakeConsole
) -> None:
    frame = console.frames.add(samples.corridor())
    console.state.add(frame)
    people = samples.people_for(frame.sequence, 640, 480, [(60.0, 100.0, 120.0, 300.0)])
    box = dataclasses.replace(people.boxes[0], person_id="p-4")
    console.state.add(dataclasses.replace(people, boxes=(box,)))
    view = window.panels["video"].view  # type: ignore[attr-defined]
    row = panel.model.row_of("p-4")
    assert row is not None
    rect = panel.list.row_rect(row)

    def seen() -> tuple[int, int]:
        inside, picture = view.grab().toImage(), view.picture_rect()
        x = round(picture.left() + 120.0 / 640 * picture.width())
        y = round(picture.top() + 250.0 / 480 * picture.height())
        in_row = (
            panel.list.viewport().grab().toImage().pixelColor(rect.left() + 3, panel.list.row_rect(row).center().y())
        )
        return inside.pixelColor(x, y).value(), in_row.blue() - in_row.red()

    panel.list.scrollTo(panel.model.index(row))
    before = seen()
    press(qtbot, panel, "p-4", "name")
    assert console.state.named_person.value == "p-4"
    after = seen()
    assert after[0] > before[0] + 10, "the person in the picture is lighter"
    assert after[1] > before[1] + 20, "the row has a blue edge"
    QTest.keyClick(find(panel, "person_name_field"), Qt.Key.Key_Escape)
    assert console.state.named_person.value == ""
    assert seen()[0] == before[0]
    qtbot.mouseMove(window, QPoint(1, 1))


def test_people_stand_in_three_groups(panel: PeoplePanel) -> None:
    unfold(panel)
    assert names(panel)[:7] == ["Luis", "Ana Torres", "Person 3", "Person 4", "Person 5", "Guest 000", "Guest 001"]
    assert names(panel)[-1] == "Mara Silva", "who is known, by name"
    assert panel.model.captions == {4: "Was here · 1", 5: "Known in this study · 21"}
    assert panel.fact[0] == "4 here · 23 known"
    heights = {row: panel.list.rowHeight(row) for row in range(7)}
    assert heights[4] == heights[5] > heights[0] == heights[3] == heights[6], "a caption has room, and only a caption"


def test_a_row_says_where_a_person_is_and_what_they_do(panel: PeoplePanel) -> None:
    assert (
        told(panel, "p-luis")
        == "Luis, Group 1, asks a lot, speaking · 1.9 m, left · standing · here for 3 min · recognised, 94 %"
    )
    assert told(panel, "p-ana") == "Ana Torres, Group 1, hand raised · 2.4 m, ahead · here for 2 min"
    assert told(panel, "p-3").startswith("Person 3, Maybe Mara Silva (82 %), 3.3 m, right · here for ")
    unfold(panel)
    assert told(panel, "p-5") == "Person 5, left 2 min ago"
    assert told(panel, "p-mara") == "Mara Silva, Group 2, shy, wheelchair, known from before"
    back = dataclasses.replace(people_samples.people_of_a_tour(10**12)[3], visit_id="p-9", confidence=0.99)
    assert what_is_seen(back, 10**12)[-1] == "was here before, 99 %", "who has no name"


@pytest.mark.parametrize(
    ("bearing_rad", "words"), [(0.1, "ahead"), (0.2, "left"), (-0.2, "right"), (3.0, "behind"), (6.2, "ahead")]
)
def test_a_bearing_is_relative_to_the_robot(bearing_rad: float, words: str) -> None:
    assert direction(bearing_rad) == words


def test_a_person_comes_back_from_the_known_to_those_who_are_here(panel: PeoplePanel, console: FakeConsole) -> None:
    unfold(panel)
    mara = next(row for row in console.state.everybody.value if row.person_id == "p-mara")
    now_ns = clock.now_ns()
    here = dataclasses.replace(mara, here=True, since_ns=now_ns, last_seen_ns=now_ns, number=9)
    console.state.persons.set((*console.state.persons.value, here))
    assert names(panel)[4:6] == ["Mara Silva", "Person 5"]
    assert names(panel).count("Mara Silva") == 1, "the list of everybody is older"
    console.state.persons.set(())
    assert names(panel).index("Mara Silva") > names(panel).index("Person 5")


def test_a_portrait_takes_the_place_of_the_round_mark(panel: PeoplePanel, console: FakeConsole) -> None:
    row = panel.model.row_of("p-4")
    assert row is not None
    panel.list.scrollTo(panel.model.index(row))
    place = panel.list.row_rect(row).adjusted(14, 7, 0, -7)
    middle = QPoint(place.left() + 19, place.center().y())
    before = panel.list.viewport().grab().toImage().pixelColor(middle)
    console.state.portraits.put("p-4/1", people_samples.portrait(220))
    rows = tuple(
        dataclasses.replace(person, portrait="p-4/1") if person.person_id == "p-4" else person
        for person in console.state.persons.value
    )
    console.state.persons.set(rows)
    after = panel.list.viewport().grab().toImage().pixelColor(middle)
    assert before != after
    assert abs(after.red() - 220) < 12


def test_a_portrait_is_decoded_once_and_one_that_is_broken_is_none(qapp: QApplication) -> None:
    asked: list[str] = []

    def jpeg_of(key: str) -> bytes | None:
        asked.append(key)
        return {"good": people_samples.portrait(90), "broken": b"no picture"}.get(key)

    pixmaps = PortraitPixmaps(jpeg_of)
    for _ in range(3):
        picture = pixmaps.pixmap("good", 38)
        assert isinstance(picture, QPixmap)
        assert picture.width() == picture.height()
        assert pixmaps.pixmap("broken", 38) is None
    assert asked == ["good", "broken"]
    assert pixmaps.pixmap("", 38) is None


def test_on_a_busy_machine_the_portraits_of_the_list_come_one_by_one(
    qapp: QApplication, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s, load = [100.0], LoadStatus(1, "thumbnails less often")
    monkeypatch.setattr("caris_desktop.ui.people.portraits.time.monotonic", lambda: now_s[0])
    pixmaps = PortraitPixmaps(lambda _key: people_samples.portrait(90), lambda: load.pays_small)
    assert pixmaps.pixmap("p-1", 38, may_wait=True) is not None
    assert pixmaps.pixmap("p-2", 38, may_wait=True) is None and pixmaps.put_off
    assert pixmaps.pixmap("p-1", 38, may_wait=True) is not None, "what is decoded stays"
    assert pixmaps.pixmap("p-3", 90) is not None, "a card that was opened is waited for"
    now_s[0] += 1.1
    assert pixmaps.pixmap("p-2", 38, may_wait=True) is not None
    load = LoadStatus()
    assert pixmaps.pixmap("p-4", 38, may_wait=True) is not None


def test_a_portrait_that_was_put_off_comes_into_the_list_automatically(
    panel: PeoplePanel, console: FakeConsole, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[tuple[str, bool]] = []
    really = PortraitPixmaps.draw

    def draw(self: PortraitPixmaps, painter: QPainter, place: QRect, key: str, *, may_wait: bool = False) -> bool:
        was_drawn = really(self, painter, place, key, may_wait=may_wait)
        drawn.append((key, was_drawn))
        return was_drawn

    monkeypatch.setattr(PortraitPixmaps, "draw", draw)
    monkeypatch.setattr(panel.model, "refresh_ages", lambda: None)  # a row whose age text changes is drawn in any case
    console.state.load.set(LoadStatus(1, "thumbnails less often"))
    meant = {"p-3": "p-3/1", "p-4": "p-4/1"}
    for key in meant.values():
        console.state.portraits.put(key, people_samples.portrait(220))
    persons = console.state.persons.value
    console.state.persons.set(
        tuple(dataclasses.replace(row, portrait=meant.get(row.person_id, row.portrait)) for row in persons)
    )
    qtbot.waitUntil(lambda: ("p-4/1", False) in drawn, timeout=5000)
    qtbot.waitUntil(lambda: {("p-3/1", True), ("p-4/1", True)} <= set(drawn), timeout=10_000)


def test_five_hundred_known_people_cost_nothing_each_second(panel: PeoplePanel, console: FakeConsole) -> None:
    rows = people_samples.many(500)
    people_samples.show_people(console, rows)
    assert panel.model.rowCount() == 501
    changed: list[int] = []
    panel.model.dataChanged.connect(lambda first, _last: changed.append(first.row()))
    panel.model.refresh_ages()
    renewed = tuple(dataclasses.replace(row) for row in rows)
    people_samples.show_people(console, renewed)
    assert changed == []
    painted: list[int] = []
    delegate = panel.list.itemDelegate()
    whole = delegate.paint
    delegate.paint = lambda painter, option, index: (painted.append(index.row()), whole(painter, option, index))[1]  # type: ignore[method-assign,func-returns-value]
    panel.list.viewport().grab()
    assert 0 < len(painted) < 30, "only what is seen is drawn"


def test_one_who_comes_moves_one_row(qapp: QApplication) -> None:
    state = LiveState()
    model = PeopleModel(state.present, state)
    rows = people_samples.many(500)
    everybody = frozenset(row.person_id for row in rows)
    model.show_persons(rows, known=everybody)
    signals: list[str] = []
    for name in ("modelReset", "rowsInserted", "rowsRemoved", "rowsMoved"):
        getattr(model, name).connect(lambda *_args, name=name: signals.append(name))
    now_ns = clock.now_ns()
    back = dataclasses.replace(rows[300], here=True, since_ns=now_ns)
    model.show_persons((*rows[:300], back, *rows[301:]), known=everybody)
    assert signals == ["rowsMoved"]
    assert model.row_of(back.person_id) == 1
    state.close()


# Suggestions


def row(person_id: str, since_ns: int, suggested: str = "", *, here: bool = True) -> PersonRow:
    suggestions = (Suggestion(suggested, suggested.title(), 0.8),) if suggested else ()
    return PersonRow(person_id, 1, person_id, here, since_ns, since_ns, suggestions=suggestions)


def test_one_suggestion_is_asked_at_a_time_and_it_stays() -> None:
    first, second = row("p-1", 10, "ada"), row("p-2", 20, "bo")
    asked = next_asked((second, first), None, selected="", now_ns=100, ended_ns=-TO_READ_NS)
    assert asked == IdentityQuestion("p-1", "ada")
    earlier = row("p-0", 1, "cy")
    assert next_asked((earlier, first, second), asked, selected="", now_ns=100, ended_ns=-TO_READ_NS) == asked
    gone = row("p-1", 10, "ada", here=False)
    after = next_asked((gone, second), asked, selected="", now_ns=100, ended_ns=-TO_READ_NS)
    assert after == IdentityQuestion("p-2", "bo", 100 + TO_READ_NS), (
        "a key that was meant for the first answers nothing"
    )
    assert next_asked((gone,), asked, selected="", now_ns=100, ended_ns=-TO_READ_NS) is None


def test_the_selected_person_is_asked_about_first() -> None:
    first, second = row("p-1", 10, "ada"), row("p-2", 20, "bo")
    asked = next_asked((first, second), None, selected="p-2", now_ns=100, ended_ns=-TO_READ_NS)
    assert asked == IdentityQuestion("p-2", "bo")


def test_another_suggestion_for_the_same_person_is_to_be_read_first() -> None:
    asked = IdentityQuestion("p-1", "ada")
    after = next_asked((row("p-1", 10, "bo"),), asked, selected="", now_ns=100, ended_ns=-TO_READ_NS)
    assert after == IdentityQuestion("p-1", "bo", 100 + TO_READ_NS)
    soon = next_asked((row("p-1", 10, "bo"),), None, selected="", now_ns=100, ended_ns=50)
    assert soon is not None
    assert soon.from_ns > 100, "the question before was answered just now"


@pytest.mark.panels()
def test_a_suggestion_is_confirmed_by_one_key_from_anywhere(
    window: MainWindow, panel: PeoplePanel, console: FakeConsole
) -> None:
    field = find(window, "speak_field")
    field.setFocus()
    QTest.keyClicks(field, "Hello")
    QTest.keyClick(field, Qt.Key.Key_Return, CTRL)
    assert console.calls == [("confirm_person", ("p-3", "p-mara"))]
    assert field.property("text") == "Hello", "nothing was said"
    assert names(panel)[2] == "Mara Silva"
    assert "recognised" not in told(panel, "p-mara"), "that was the wizard"
    QTest.keyClick(field, Qt.Key.Key_Return, CTRL)
    assert len(console.calls) == 1, "nothing is asked any more"


@pytest.mark.panels()
def test_while_driving_y_says_yes_and_shift_y_no(window: MainWindow, panel: PeoplePanel, console: FakeConsole) -> None:
    view = find(window, "video_view")
    view.setFocus()
    before = console.state.persons.value
    QTest.keyClick(view, Qt.Key.Key_Y, SHIFT)
    assert console.calls == [("reject_person", ("p-3", "p-mara"))]
    console.state.persons.set(before)
    asked = console.state.asked_person.value
    assert asked is not None
    # Shown again just after it was answered.
    QTest.keyClick(view, Qt.Key.Key_Y)
    assert len(console.calls) == 1
    console.state.asked_person.set(dataclasses.replace(asked, from_ns=0))
    QTest.keyClick(view, Qt.Key.Key_Y)
    assert console.calls[1:] == [("confirm_person", ("p-3", "p-mara"))]


def test_ctrl_enter_while_a_name_is_typed_is_no_name(
    qtbot: QtBot, window: MainWindow, panel: PeoplePanel, console: FakeConsole
) -> None:
    press(qtbot, panel, "p-4", "name")
    field = find(panel, "person_name_field")
    QTest.keyClicks(field, "Eva")
    QTest.keyClick(field, Qt.Key.Key_Return, CTRL)
    assert console.calls == [("confirm_person", ("p-3", "p-mara"))]
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert console.calls[1:] == [("rename_person", ("p-4", "Eva"))]


def test_a_suggestion_is_answered_by_a_click(qtbot: QtBot, panel: PeoplePanel, console: FakeConsole) -> None:
    press(qtbot, panel, "p-3", "no")
    assert console.calls == [("reject_person", ("p-3", "p-mara"))]
    people_samples.show_people(console, people_samples.people_of_a_tour())
    press(qtbot, panel, "p-3", "yes")
    assert console.calls[1:] == [("confirm_person", ("p-3", "p-mara"))]


@pytest.mark.panels()
def test_the_row_and_the_box_that_are_asked_about_have_the_key(
    window: MainWindow, panel: PeoplePanel, console: FakeConsole
) -> None:
    find(window, "video_view").setFocus()
    asked = panel.model.row_of("p-3")
    assert asked is not None
    keys = [button.key for button in panel.list.buttons(asked)]
    assert keys == ["Y", "⇧Y", ""]
    frame = console.frames.add(samples.corridor())
    console.state.add(frame)
    people = samples.people_for(frame.sequence, 640, 480, [(60.0, 100.0, 120.0, 300.0)])
    box = dataclasses.replace(people.boxes[0], person_id="p-3")
    console.state.add(dataclasses.replace(people, boxes=(box,)))
    view = window.panels["video"].view  # type: ignore[attr-defined]
    assert view.visible_detections() == [("Mara Silva? 82 % · Y", False)]
    image, amber = view.grab().toImage(), window.theme.color("box_warning")
    rect = view.picture_rect()
    row_px = round(rect.top() + rect.height() / 2)
    left = round(rect.left() + 60.0 / 640 * rect.width())
    edge = [image.pixelColor(x, y) for x in range(left - 3, left + 3) for y in range(row_px - 20, row_px + 20)]
    assert any(color == amber for color in edge)
    find(window, "speak_field").setFocus()
    assert view.visible_detections() == [("Mara Silva? 82 % · Ctrl Enter", False)]


@pytest.mark.panels()
def test_a_question_comes_into_view_once(panel: PeoplePanel, console: FakeConsole) -> None:
    viewport = panel.list.viewport()
    assert viewport.height() < 3 * ROW_PX, "there is room for less than three rows"
    asked = panel.model.row_of("p-3")
    assert asked is not None
    assert viewport.rect().contains(panel.list.row_rect(asked))
    panel.list.scrollToTop()
    people_samples.show_people(console, people_samples.people_of_a_tour())
    assert not viewport.rect().contains(panel.list.row_rect(asked)), "where the wizard scrolled it stays"


def test_a_recognised_person_can_be_another_after_all(qtbot: QtBot, panel: PeoplePanel, console: FakeConsole) -> None:
    press(qtbot, panel, "p-luis", "not")
    assert console.calls == [("reject_person", ("p-luis", "p-luis"))]
    named_by_hand = panel.model.row_of("p-ana")
    assert named_by_hand is not None
    assert "not" not in [button.act for button in panel.list.buttons(named_by_hand)]


# Selection, search, undo


@pytest.mark.panels()
def test_a_click_selects_a_person_and_the_next_one_nobody(
    qtbot: QtBot, window: MainWindow, panel: PeoplePanel, console: FakeConsole
) -> None:
    before = panel.list.viewport().grab().toImage()
    press(qtbot, panel, "p-luis", "pick")
    assert console.state.selected_person.value == "p-luis"
    assert panel.list.viewport().grab().toImage() != before
    assert find(window, "speak_field").property("placeholderText") == "Type what the robot says to Luis…"
    press(qtbot, panel, "p-luis", "pick")
    assert console.calls == [("attend_person", "p-luis"), ("attend_person", "")]
    assert find(window, "speak_field").property("placeholderText") == "Type what the robot says…"


def test_the_keyboard_selects_too(panel: PeoplePanel, console: FakeConsole) -> None:
    panel.list.setFocus()
    panel.list.setCurrentIndex(panel.model.index(1))
    QTest.keyClick(panel.list, Qt.Key.Key_Space)
    assert console.calls == [("attend_person", "p-ana")]


def test_people_are_found_by_name_group_and_tag(
    qtbot: QtBot, window: MainWindow, panel: PeoplePanel, console: FakeConsole
) -> None:
    click(qtbot, find(window, "people_search_button"))
    field = find(panel, "people_search")
    QTest.keyClicks(field, "wheel")
    assert names(panel) == ["Mara Silva"]
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert console.calls == [("attend_person", "p-mara")]
    field.setProperty("text", "group 1 ana")
    assert names(panel) == ["Ana Torres"]
    panel.list.verticalScrollBar().setValue(500)
    field.setProperty("text", "guest")
    assert panel.list.row_rect(0).top() <= CAPTION_PX, "what is found is seen from its first"
    field.setProperty("text", "xyz")
    assert names(panel) == []
    assert "xyz" in find(panel, "people_empty").property("text")
    QTest.keyClick(field, Qt.Key.Key_Escape)
    assert console.calls[-1] == ("stop", None), "Esc stops the robot first of all"
    assert not field.isVisible()
    assert len(names(panel)) == 25


def test_every_word_has_to_be_there() -> None:
    mara = people_samples.people_of_a_tour(10**12)[5]
    assert found(mara, " SILVA shy ")
    assert not found(mara, "silva luis")
    assert found(mara, "")


def test_a_decision_of_the_wizard_can_be_undone(
    qtbot: QtBot, window: MainWindow, panel: PeoplePanel, console: FakeConsole
) -> None:
    bar = panel.findChild(UndoBar)
    assert bar.isHidden()
    press(qtbot, panel, "p-3", "yes")
    assert bar.isVisible()
    assert bar.text.text() == "Mara Silva confirmed"
    click(qtbot, find(panel, "people_undo_button"))
    assert console.calls[-1] == ("undo_people", None)
    assert bar.isHidden()
    panel.list.setFocus()
    QTest.keyClick(panel.list, Qt.Key.Key_Z, CTRL)
    assert console.named("undo_people") == [None, None]


def test_a_decision_is_reported_with_the_resulting_name(panel: PeoplePanel, console: FakeConsole) -> None:
    console.state.add(PersonRenamed(clock.now_ns(), "p-4", "wizard"))
    bar = panel.findChild(UndoBar)
    assert bar.text.text() == "Named Person 4"
    rows = console.state.persons.value
    console.state.persons.set((*rows[:3], dataclasses.replace(rows[3], name="Eva")))
    assert bar.text.text() == "Named Eva"


def test_a_decision_of_the_console_offers_no_undo(panel: PeoplePanel, console: FakeConsole) -> None:
    console.state.add(PersonIdentified(clock.now_ns(), "p-4", "p-ana", "console", 0.97, actor="console"))
    assert panel.findChild(UndoBar).isHidden()


def test_ctrl_z_in_a_field_is_the_fields_own(qtbot: QtBot, panel: PeoplePanel, console: FakeConsole) -> None:
    press(qtbot, panel, "p-4", "name")
    field = find(panel, "person_name_field")
    assert isinstance(field, QLineEdit)
    QTest.keyClicks(field, "Eva")
    QTest.keyClick(field, Qt.Key.Key_Z, CTRL)
    assert field.text() == ""
    assert console.calls == []


def test_a_name_being_typed_stays_when_naming_is_asked_for_again(panel: PeoplePanel) -> None:
    panel.list.name("p-4")
    field = find(panel, "person_name_field")
    QTest.keyClicks(field, "Eva")
    panel.list.name("p-4")
    assert field.property("text") == "Eva" and field.hasFocus()


def test_a_name_being_typed_stays_when_its_panel_moves_or_its_rows_change(
    qtbot: QtBot, window: MainWindow, panel: PeoplePanel, console: FakeConsole
) -> None:
    panel.list.name("p-4")
    field = find(panel, "person_name_field")
    QTest.keyClicks(field, "Ev")
    for change in (
        lambda: window.dock_host.toggle_floating("people"),
        lambda: many_come(console, 30),
        lambda: window.dock_host.toggle_floating("people"),
        lambda: many_come(console, 0),
    ):
        change()
        qtbot.waitUntil(field.hasFocus)
        assert field.property("text") == "Ev"
    QTest.keyClicks(field, "a")
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert console.calls == [("rename_person", ("p-4", "Eva"))]


def many_come(console: FakeConsole, number: int) -> None:
    first = people_samples.people_of_a_tour()
    more = [dataclasses.replace(first[0], person_id=f"new-{each}", name="") for each in range(number)]
    people_samples.show_people(console, (*more, *first))


def test_an_unfinished_name_is_not_saved_when_another_row_becomes_current(
    qtbot: QtBot, panel: PeoplePanel, console: FakeConsole
) -> None:
    press(qtbot, panel, "p-4", "name")
    QTest.keyClicks(find(panel, "person_name_field"), "Ev")
    panel.show_person("p-luis")
    assert console.calls == [] and not panel.list.naming
    assert panel.list.hasFocus(), "what is typed on does nothing"


# Without a decision


@pytest.fixture
def no_names(
    qtbot: QtBot, settings: MemorySettings, theme: Theme
) -> Iterator[tuple[MainWindow, FakeConsole, PeoplePanel]]:
    scenario = dataclasses.replace(samples.TOUR, permissions=Permissions(naming_people=False))
    console = FakeConsole(scenario)
    window = open_window(qtbot, console, settings, theme)
    panel = window.panels["people"]
    assert isinstance(panel, PeoplePanel)
    people_samples.show_people(console, people_samples.people_of_a_tour())
    yield window, console, panel


def test_without_names_there_is_presence_and_nothing_else(
    no_names: tuple[MainWindow, FakeConsole, PeoplePanel], qtbot: QtBot
) -> None:
    window, console, panel = no_names
    assert names(panel) == ["Person 1", "Person 2", "Person 3", "Person 4"]
    assert told(panel, "p-3").startswith("Person 3, 3.3 m, right")
    assert panel.fact[0] == "4 here"
    assert panel.title_widgets() == []
    assert [panel.list.buttons(row) for row in range(4)] == [(), (), (), ()] and not panel.list.controls
    console.calls.clear()
    QTest.keyClick(find(window, "speak_field"), Qt.Key.Key_Return, CTRL)
    panel.list.setFocus()
    for key in (Qt.Key.Key_Return, Qt.Key.Key_Right):
        panel.list.setCurrentIndex(panel.model.index(0))
        QTest.keyClick(panel.list, key)
    QTest.keyClick(panel.list, Qt.Key.Key_Z, CTRL)
    assert console.calls == []
    assert panel.card is None
    frame = console.frames.add(samples.corridor())
    console.state.add(frame)
    people = samples.people_for(frame.sequence, 640, 480, [(60.0, 100.0, 120.0, 300.0)])
    console.state.add(dataclasses.replace(people, boxes=(dataclasses.replace(people.boxes[0], person_id="p-luis"),)))
    assert window.panels["video"].view.visible_detections() == [("Person 1", False)]  # type: ignore[attr-defined]
    texts = [entry.text for entry in window.palette_entries()]
    assert not [text for text in texts if "Luis" in text]
    assert "Undo the last change to people" not in texts


def test_a_replay_shows_people_and_asks_nothing(qtbot: QtBot, settings: MemorySettings, theme: Theme) -> None:
    console = FakeConsole(samples.TOUR)
    console.state.close()
    console.state = LiveState(present=PresentClock(live=False))
    console.state.scenario.set(samples.TOUR)
    window = open_window(qtbot, console, settings, theme)
    panel = window.panels["people"]
    assert isinstance(panel, PeoplePanel)
    people_samples.show_people(console, people_samples.people_of_a_tour())
    assert names(panel)[0] == "Luis"
    assert [panel.list.buttons(row) for row in range(4)] == [(), (), (), ()] and not panel.list.controls
    console.calls.clear()
    panel.list.setFocus()
    panel.list.setCurrentIndex(panel.model.index(0))
    QTest.keyClick(panel.list, Qt.Key.Key_Return)
    QTest.keyClick(panel.list, Qt.Key.Key_Z, CTRL)
    assert console.calls == []


# Command palette


def test_people_are_found_in_the_palette(window: MainWindow, panel: PeoplePanel, console: FakeConsole) -> None:
    entries = {entry.text: entry for entry in window.palette_entries()}
    entries["Mara Silva"].do()
    assert console.calls == [("attend_person", "p-mara")]
    assert entries["Yes, Person 3 is Mara Silva"].key in ("Y", "Ctrl Enter")
    entries["No, Person 3 is not Mara Silva"].do()
    assert console.calls[1:] == [("reject_person", ("p-3", "p-mara"))]
    entries["Rename Ana Torres"].do()
    field = find(panel, "person_name_field")
    assert isinstance(field, QLineEdit)
    assert field.text() == "Ana Torres"
    entries["Undo the last change to people"].do()
    assert console.calls[2:] == [("undo_people", None)]
    entries["Details of Luis"].do()
    assert panel.card is not None
    assert panel.card.person_id == "p-luis"


def test_the_description_of_a_person_begins_with_the_important() -> None:
    luis = people_samples.people_of_a_tour(10**12)[0]
    assert what_is_seen(luis, 10**12)[:2] == ["speaking", "1.9 m, left"]
