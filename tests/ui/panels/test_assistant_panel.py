"""Assistant panel: concurrent questions, context and model, all by keyboard."""

from dataclasses import replace
from pathlib import Path

import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QFileDialog, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.conversation.conversation_transcript import Turn
from caris_desktop.live.status import AssistantSetup, AssistantStatus, ContextPartStatus, ExchangeStatus, ModelChoice
from caris_desktop.scenario.scenario_model import NamedText
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.assistant_panel import AssistantPanel
from caris_desktop.ui.widgets.buttons import ActionButton
from tests.ui.conftest import find
from tests.ui.fake_console import FakeConsole

pytestmark = pytest.mark.panels("assistant")

SETUP = AssistantSetup(
    model="embedded",
    models=(
        ModelChoice("embedded", "SmolLM2 on this computer", "on this computer"),
        ModelChoice("ollama:llama", "llama", "on this computer"),
    ),
    system_prompt="You are a guide.",
    styles=(NamedText("Short", "Ten words."),),
    templates=(NamedText("Meaning", "What is meant by {said}?"),),
    notes="The arm rests.",
    pictures=True,
    parts=(ContextPartStatus("conversation", "Conversation", 6, 124), ContextPartStatus("notes", "Notes", 1, 1)),
)
WRITING = ExchangeStatus("x3", "What could I ask?", "answering", "Small", "You could")
ANSWERED = ExchangeStatus("x2", "Is it dangerous?", "answered", "Small", "It stops at once.")
FAILED = ExchangeStatus("x1", "How heavy is it?", "failed", "Small", "", "The server failed. Ask again in a moment.")


@pytest.fixture
def panel(window: MainWindow, console: FakeConsole) -> AssistantPanel:
    window.open_panel("assistant")
    panel = window.panels["assistant"]
    assert isinstance(panel, AssistantPanel)
    console.state.assistant_setup.set(SETUP)
    console.state.assistant.set(AssistantStatus("ready", "Small"))
    console.calls.clear()
    panel.field.setFocus()
    return panel


def asked(console: FakeConsole, *exchanges: ExchangeStatus) -> None:
    state = "answering" if any(each.is_pending for each in exchanges) else "ready"
    newest = exchanges[0]
    console.state.assistant.set(
        AssistantStatus(state, "Small", newest.exchange_id, newest.question, newest.answer, newest.detail, exchanges)
    )


@pytest.mark.panels()
def test_context_is_listed_with_its_size_and_removed_before_sending(
    panel: AssistantPanel, console: FakeConsole
) -> None:
    assert not panel.along.isVisible(), "the last answer has the room until something is written"
    QTest.keyClicks(panel.field, "What now?")
    assert [chip.text() for chip in panel.along.chips] == ["Conversation · 124 words", "Notes · 1 word"]
    conversation = find(panel, "along_conversation")
    conversation.setFocus(Qt.FocusReason.TabFocusReason)
    QTest.keyClick(conversation, Qt.Key.Key_Space)
    assert "Not included" in conversation.accessibleDescription()
    panel.setup_bar.picture_chosen.emit("camera front")
    panel.field.setFocus()
    QTest.keyClick(panel.field, Qt.Key.Key_Return)
    assert console.calls == [("ask_assistant", "What now?")]
    assert console.asked_with == (("conversation",), ("camera front",))
    assert panel.field.text() == "" and panel.along.pictures == ()
    assert panel.along.left_out == ("conversation",), "it stays out until it is put back"


def test_a_question_that_is_refused_stays_in_the_field_with_its_pictures(
    panel: AssistantPanel, console: FakeConsole, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(console, "ask_assistant", lambda *_, **__: False)
    panel.field.setText("What now?")
    panel.along.add_picture("camera front")
    QTest.keyClick(panel.field, Qt.Key.Key_Return)
    assert panel.field.text() == "What now?" and panel.along.pictures == ("camera front",)


def test_a_question_can_be_asked_while_another_is_answered(panel: AssistantPanel, console: FakeConsole) -> None:
    asked(console, WRITING)
    panel.field.setText("And this?")
    QTest.keyClick(panel.field, Qt.Key.Key_Return)
    assert console.calls == [("ask_assistant", "And this?")]


def test_each_question_has_its_line_and_is_spoken_cancelled_and_dismissed_by_keys(
    panel: AssistantPanel, console: FakeConsole
) -> None:
    asked(console, WRITING, ANSWERED, FAILED)
    assert panel.fact == ("Small is writing", "blue")
    QTest.keyClick(panel.field, Qt.Key.Key_Down)
    answer = panel._answer
    assert answer.toPlainText() == "It stops at once."
    panel._rows.setFocus()
    QTest.keyClick(panel._rows, Qt.Key.Key_Return)
    assert console.calls == [("say_answer", "It stops at once.")]
    QTest.keyClick(panel._rows, Qt.Key.Key_Return, Qt.KeyboardModifier.ShiftModifier)
    assert answer.hasFocus() and not answer.isReadOnly()
    asked(console, replace(WRITING, answer="You could ask"), ANSWERED, FAILED)
    assert answer.toPlainText() == "It stops at once.", "what comes meanwhile does not take its place"
    QTest.keyClicks(answer, " Really.")
    QTest.keyClick(answer, Qt.Key.Key_Return)
    assert console.calls[-1] == ("say_answer", "It stops at once. Really.")
    panel._rows.setFocus()
    QTest.keyClick(panel._rows, Qt.Key.Key_Down)
    assert "The server failed" in panel._note.text()
    QTest.keyClick(panel._rows, Qt.Key.Key_Delete)
    assert console.calls[-1] == ("dismiss_answer", "x1")
    QTest.keyClick(panel._rows, Qt.Key.Key_Up)
    QTest.keyClick(panel._rows, Qt.Key.Key_Up)
    panel._cancel.click()
    assert console.calls[-1] == ("cancel_assistant", "x3")
    asked(console, ANSWERED)
    assert answer.toPlainText() == "It stops at once."


def test_an_answer_that_is_cut_off_says_so(panel: AssistantPanel, console: FakeConsole) -> None:
    asked(console, replace(ANSWERED, detail="The answer is cut off: the server's filter stopped it."))
    note = find(panel, "assistant_note")
    assert note.isVisible() and "cut off" in note.property("text")


def test_what_must_be_read_first_is_not_said_by_the_primary_button(panel: AssistantPanel, console: FakeConsole) -> None:
    def primary() -> str:
        buttons = panel.findChildren(ActionButton)
        return next(button.objectName() for button in buttons if button.isVisible() and button._role == "primary")

    console.state.assistant_setup.set(replace(SETUP, model="ollama:llama3"))
    asked(console, ANSWERED)
    assert primary() == "assistant_say"
    asked(console, replace(ANSWERED, detail="The answer is cut off: the server's filter stopped it."))
    assert primary() == "assistant_edit"
    console.state.assistant_setup.set(replace(SETUP, model="embedded"))
    asked(console, replace(ANSWERED, answer="Hello, I'm here."))
    assert primary() == "assistant_edit", "the model for practice continues the question"


def test_the_model_is_one_drop_down_and_a_refusal_puts_it_back(
    panel: AssistantPanel, console: FakeConsole, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = panel.setup_bar.model
    assert [model.itemText(at) for at in range(model.count())] == [
        "SmolLM2 on this computer",
        "llama · on this computer",
        "Add a model file…",
    ]
    model.setCurrentIndex(1)
    model.activated.emit(1)
    assert console.calls == [("choose_model", "ollama:llama")]
    monkeypatch.setattr(console, "choose_model", lambda model: model == "")
    model.setCurrentIndex(0)
    model.activated.emit(0)
    assert model.currentData() == "ollama:llama"
    assert panel.setup_bar.role.isHidden(), "the scenario has no roles"
    panel.setup_bar.style_choice.activated.emit(1)
    assert console.calls[-1] == ("choose_prompt", ("style", "Short"))


def test_a_model_file_is_added_from_the_list_of_models(
    panel: AssistantPanel, console: FakeConsole, window: MainWindow, tmp_path: Path
) -> None:
    model = panel.setup_bar.model
    model.setCurrentIndex(2)
    model.activated.emit(2)
    assert model.currentData() == "embedded", "adding chooses no model"
    dialog = window.findChild(QFileDialog, "model_file_dialog")
    assert dialog is not None and dialog.isVisible() and not dialog.isModal()
    dialog.fileSelected.emit(str(tmp_path / "large.gguf"))
    assert console.calls == [("add_model", tmp_path / "large.gguf")]
    dialog.close()


@pytest.mark.panels()
def test_the_model_can_be_chosen_however_low_the_panel_is(panel: AssistantPanel, console: FakeConsole) -> None:
    asked(console, ANSWERED)
    assert panel.height() < 210 and panel._answer.isVisible() and not panel.setup_bar.model.isVisible()
    panel.setup_button.setFocus(Qt.FocusReason.TabFocusReason)
    QTest.keyClick(panel.setup_button, Qt.Key.Key_Space)
    assert panel.setup_bar.model.isVisible() and not panel._answer.isVisible()
    QTest.keyClick(panel.setup_button, Qt.Key.Key_Space)
    assert panel._answer.isVisible()


def test_a_prepared_question_has_the_last_utterance(panel: AssistantPanel, console: FakeConsole) -> None:
    console.state.transcript.set((Turn("u1", "participant", "It is so tall.", "heard", "finished", 1, 2),))
    panel.setup_bar.template.activated.emit(1)
    assert panel.field.text() == "What is meant by “It is so tall.”?"
    assert panel.field.hasFocus() and console.calls == []


def test_the_words_are_changed_on_the_spot_and_put_back(
    qtbot: QtBot, panel: AssistantPanel, console: FakeConsole
) -> None:
    panel.setup_bar.words.click()
    words = panel._words
    assert words.field.hasFocus() and words.field.toPlainText() == "You are a guide."
    assert not words.save.isEnabled() and not words.reset.isEnabled()
    words.field.setPlainText("You are a nurse.")
    console.state.assistant_setup.set(replace(SETUP, parts=()))
    assert words.field.toPlainText() == "You are a nurse.", "what is being written stays"
    words.save.click()
    assert console.calls == [("edit_prompt", ("system_prompt", "", "You are a nurse."))]
    console.state.assistant_setup.set(replace(SETUP, system_prompt="You are a nurse.", edited=True))
    words.which.setCurrentIndex(2)
    words.which.activated.emit(2)
    assert words.field.toPlainText() == "Ten words."
    words.reset.click()
    assert console.calls[-1] == ("reset_prompts", None)
    words.back.click()
    assert panel.field.isVisible() and panel.field.hasFocus()


def test_a_recording_of_one_question_at_a_time_is_shown_as_it_was(panel: AssistantPanel, console: FakeConsole) -> None:
    console.state.assistant.set(AssistantStatus("ready", "Small", "x9", "Why?", "Therefore."))
    assert panel._answer.toPlainText() == "Therefore."
    assert panel.findChild(QWidget, "assistant_rows").isHidden()  # type: ignore[union-attr]


def test_before_the_models_are_known_there_is_no_list_of_none(panel: AssistantPanel, console: FakeConsole) -> None:
    model = find(panel, "assistant_model")
    assert not model.isHidden()
    console.state.assistant_setup.set(replace(SETUP, models=()))
    assert model.isHidden()
