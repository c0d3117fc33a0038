"""Activation, focus and physical keys on a virtual screen with a window manager."""

import itertools
from collections.abc import Iterator

import pytest

from tests.support.virtual_desktop import MISSING_TOOLS, VirtualDesktop

pytestmark = [
    pytest.mark.alone,
    pytest.mark.skipif(bool(MISSING_TOOLS), reason=f"needs {', '.join(MISSING_TOOLS)}"),
]

FORWARD = "drive (1.0, 0.0, 0.0, 'keyboard')"
LEFT = "drive (0.0, 0.0, 1.0, 'keyboard')"
_numbers = itertools.count(1)
_OTHER = """
from PySide6.QtWidgets import QApplication, QWidget

app = QApplication([])
window = QWidget()
window.show()
window.activateWindow()
app.exec()
"""


@pytest.fixture(scope="module")
def whole_desktop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[VirtualDesktop]:
    desktop = VirtualDesktop(tmp_path_factory.mktemp("desktop"), "tests.ui.desktop_subject")
    try:
        desktop.wait_for("READY True", timeout_s=40.0)
        yield desktop
    finally:
        desktop.close()


class Desktop:
    """The desktop since the start of a test: earlier output is ignored."""

    def __init__(self, desktop: VirtualDesktop) -> None:
        self._desktop = desktop
        self.do, self.send_command, self.use_layout = desktop.do, desktop.send_command, desktop.use_layout
        number = next(_numbers)
        desktop.send_command(f"reset {number}")
        self.at = desktop.wait_for(f"RESET {number}")
        self.began = self.at

    def expect(self, *lines: str, timeout_s: float = 10.0) -> None:
        """Wait for these lines in this order after the last expected one."""
        for line in lines:
            self.at = self._desktop.wait_for(line, after=self.at, timeout_s=timeout_s)

    def expect_all(self, *lines: str) -> None:
        """Wait for these lines in any order."""
        self.at = max(self._desktop.wait_for(line, after=self.at) for line in lines)

    def since(self, start: int | None = None) -> list[str]:
        return self._desktop.lines()[self.began if start is None else start :]

    def intents(self, name: str) -> list[str]:
        return [line for line in self.since() if line.startswith(name + " ")]

    def click(self, name: str) -> None:
        """Press the left button in the middle of a widget."""
        start = len(self._desktop.lines())
        self.send_command(f"where {name}")
        end = self._desktop.wait_for(f"WHERE {name}", after=start)
        x, y = self._desktop.lines()[end - 1].split()[2:]
        self.do("mousemove", x, y, "click", "1")

    def place(self, word: str, name: str) -> tuple[int, int]:
        """Position on the screen."""
        start = len(self._desktop.lines())
        self.send_command(f"{word} {name}")
        end = self._desktop.wait_for(f"{word.upper()} {name}", after=start)
        x, y = self._desktop.lines()[end - 1].split()[2:]
        return int(x), int(y)

    def drag(self, start: tuple[int, int], *stops: tuple[int, int]) -> None:
        moves = [word for x, y in stops for word in ("mousemove", str(x), str(y), "sleep", "0.05")]
        self.do("mousemove", str(start[0]), str(start[1]), "mousedown", "1", *moves, "mouseup", "1")

    def start_other_program(self):  # type: ignore[no-untyped-def]
        return self._desktop.start_program(_OTHER)


@pytest.fixture
def desktop(whole_desktop: VirtualDesktop) -> Desktop:
    return Desktop(whole_desktop)


def test_two_keys_and_opposite_keys(desktop: Desktop) -> None:
    desktop.do("keydown", "w")
    desktop.expect(FORWARD)
    desktop.do("keydown", "a")
    desktop.expect("drive (1.0, 0.0, 1.0, 'keyboard')")
    desktop.do("keydown", "s")  # forward and back at once: neither
    desktop.expect(LEFT)
    desktop.do("keyup", "w")
    desktop.expect("drive (-1.0, 0.0, 1.0, 'keyboard')")
    desktop.do("keyup", "s", "keyup", "a")
    desktop.expect("release_drive")


def test_a_held_key_repeats_nothing(desktop: Desktop) -> None:
    for key in ("w", "F1"):
        desktop.do("keydown", key, "sleep", "0.9", "keyup", key)
    desktop.do("key", "F2")
    desktop.expect("say ('Please follow me.', 'phrase')")
    assert len(desktop.intents("drive")) == 1
    assert len(desktop.intents("say")) == 2


def test_a_held_key_repeats_only_where_it_was_pressed(desktop: Desktop) -> None:
    desktop.do("key", "ctrl+l")
    desktop.expect("KEYS typing")
    desktop.do("type", "draft")
    desktop.expect("TEXT ('draft', 5)")
    desktop.do("key", "ctrl+d")
    desktop.expect("KEYS driving")
    desktop.do("keydown", "Return", "sleep", "1.0", "keyup", "Return")  # go to the field
    desktop.expect("KEYS typing")
    desktop.do("key", "x")
    desktop.expect("TEXT ('draftx', 6)")
    assert not desktop.intents("say")
    desktop.do("keydown", "Return")
    desktop.expect("say ('draftx'")
    desktop.send_command("dialog")
    desktop.expect("DIALOG True")
    desktop.do("sleep", "1.0", "keyup", "Return")
    desktop.do("keydown", "x", "sleep", "0.2", "keyup", "x", "key", "Escape")
    desktop.expect("DIALOG False")
    assert not desktop.intents("start_session")


def test_escape_closes_the_help_of_a_dialog_and_then_the_dialog(desktop: Desktop) -> None:
    desktop.send_command("dialog")
    desktop.expect("ACTIVE StartDialog")
    desktop.do("key", "F1")
    desktop.expect("ACTIVE HelpWindow")
    desktop.do("key", "Escape")
    desktop.expect("stop", "ACTIVE StartDialog")
    assert "DIALOG False" not in desktop.since()
    desktop.do("sleep", "0.1", "key", "Escape")
    desktop.expect("DIALOG False")


def test_qt_is_told_which_presses_are_repeats(desktop: Desktop) -> None:
    """Otherwise a button held by Space is pressed thirty times a second, and a list confirms each."""
    desktop.send_command("count_presses")
    desktop.expect("KEYS window")
    desktop.do("keydown", "space", "sleep", "1.0", "keyup", "space")
    desktop.expect("CLICKED 1")
    desktop.do("keydown", "Return", "sleep", "1.0", "keyup", "Return")
    desktop.do("key", "space")
    desktop.expect("CLICKED 2")


def test_driving_and_typing_do_not_get_into_each_other(desktop: Desktop) -> None:
    desktop.do("key", "Return")  # focus to the Speak field
    desktop.expect("KEYS typing")
    desktop.do("type", "--delay", "5", "wads")
    desktop.expect("TEXT ('wads', 4)")
    for keys, intent in (
        (("alt", "w"), FORWARD), (("alt", "Left"), LEFT), (("alt", "Down"), "drive (-1.0, 0.0, 0.0, 'keyboard')"),
        (("KP_Up",), FORWARD), (("KP_Left",), LEFT), (("shift", "KP_Up"), FORWARD),
        (("KP_Right",), "drive (0.0, 0.0, -1.0, 'keyboard')"),
    ):  # fmt: skip
        desktop.do(*(word for key in keys for word in ("keydown", key)))
        desktop.expect(intent)
        desktop.do(*(word for key in reversed(keys) for word in ("keyup", key)))
        desktop.expect("release_drive")
    # Alt is released first, and W stays pressed longer than the repeat delay.
    desktop.do("keydown", "alt", "keydown", "w")
    desktop.expect(FORWARD)
    desktop.do("keyup", "alt", "sleep", "0.8", "keyup", "w")
    desktop.expect("release_drive")
    # Plain letters and arrows never drive here; arrows move the cursor.
    drives = len(desktop.intents("drive"))
    desktop.do("key", "Left", "key", "Left", "key", "w", "key", "Right")
    desktop.expect("TEXT ('wawds', 4)")
    assert len(desktop.intents("drive")) == drives
    # Nothing else was typed meanwhile, and only the arrows moved the cursor.
    texts = {line.removeprefix("TEXT ") for line in desktop.since() if line.startswith("TEXT ('w")}
    assert texts <= {"('w', 1)", "('wa', 2)", "('wad', 3)"} | {
        "('wads', 4)", "('wads', 3)", "('wads', 2)", "('wawds', 3)", "('wawds', 4)",
    }  # fmt: skip


def test_marks_by_real_keys_while_driving_and_typing(desktop: Desktop) -> None:
    def counted() -> dict[str, int]:
        return {name: len(desktop.intents(name)) for name in ("mark", "stretch_mark", "end_mark")}

    desktop.do("keydown", "w", "keydown", "m", "sleep", "1.2", "keyup", "m")
    desktop.expect(FORWARD, "mark ('', 'mark')", "stretch_mark", "end_mark")
    assert counted() == {"mark": 1, "stretch_mark": 1, "end_mark": 1}, "a held key repeats nothing"
    assert not desktop.intents("release_drive")
    desktop.do("keyup", "w", "key", "Return")
    desktop.expect("release_drive", "KEYS typing")
    desktop.do("keydown", "alt", "keydown", "w")
    desktop.expect(FORWARD)
    desktop.do("key", "ctrl+m")
    desktop.expect("mark ('', 'mark')")
    desktop.do("key", "ctrl+shift+m", "key", "g")
    desktop.expect("mark ('', 'wizard_error')", "change_mark")
    assert "'late'" in desktop.intents("change_mark")[0]
    desktop.do("key", "ctrl+n")
    desktop.do("keyup", "w", "keyup", "alt")
    desktop.expect("release_drive")
    desktop.do("type", "--delay", "5", "wads")
    desktop.do("key", "Return")
    desktop.expect("add_note wads")
    assert len(desktop.intents("drive")) == 2
    assert not [line for line in desktop.since() if line.startswith("TEXT ('") and not line.startswith("TEXT ('',")]


def test_nothing_closes_while_alt_drives(desktop: Desktop) -> None:
    desktop.do("key", "Return")
    desktop.expect("KEYS typing")
    desktop.do("keydown", "alt", "keydown", "w")
    desktop.expect(FORWARD)
    desktop.do("key", "F2")  # not bound by the window manager
    desktop.expect("say ('Please follow me.', 'phrase')")
    assert not desktop.intents("release_drive")
    desktop.do(
        "keydown", "F4", "sleep", "0.9", "keyup", "F4"
    )  # bound by the window manager, which closes windows repeatedly
    desktop.expect("release_drive The window manager took over the keyboard", "say ('Let me think…', 'phrase')")
    desktop.do("keyup", "w", "keydown", "w")
    desktop.expect(FORWARD)
    desktop.do("keyup", "w", "keyup", "alt")
    desktop.expect("release_drive")
    assert len(desktop.intents("say")) == 2
    # Alone it closes, after a question; Esc stops while the question is open.
    desktop.do("key", "alt+F4")
    desktop.expect("QUESTION Close the console? The recording will stop and be saved.")
    desktop.do("key", "Escape")
    desktop.expect("stop", "QUESTION")
    assert "QUESTION None" in desktop.since()
    assert not [line for line in desktop.since() if "CLOSED" in line]
    desktop.do("type", "--delay", "5", "w")
    desktop.expect("TEXT ('w', 1)")


def test_keys_are_known_by_their_place_on_the_keyboard(desktop: Desktop) -> None:
    desktop.use_layout("fr")
    try:
        desktop.do("keydown", "25")  # right of the first letter: Z in this layout
        desktop.expect(FORWARD)
        desktop.do("keyup", "25")
        desktop.expect("release_drive")
        assert "CAP Z" in desktop.since(), "the key cap shows what is printed on the key"
        desktop.do("keydown", "38", "keyup", "38")  # the first letter of the second row: Q in this layout
        desktop.expect(LEFT, "release_drive")
        desktop.do("key", "11")  # the 2 above it, which is é
        desktop.expect("go_to_place Lab bench")
        desktop.do("key", "Return")
        desktop.expect("KEYS typing", "CAP Alt Z")
        desktop.do("key", "25", "key", "52")
        desktop.expect("TEXT ('zw', 2)")
        drives = len(desktop.intents("drive"))
        desktop.do(
            "keydown", "alt", "key", "52", "keydown", "25"
        )  # the position of W in this layout does not drive forward
        desktop.expect(FORWARD)
        desktop.do("keyup", "25", "keyup", "alt")
        desktop.expect("release_drive")
        assert len(desktop.intents("drive")) == drives + 1
        assert not [line for line in desktop.since() if line.startswith("TEXT ('zw") and "'zw'" not in line]
    finally:
        desktop.use_layout("us")
    desktop.do("key", "Escape", "keydown", "alt", "key", "25", "keyup", "alt")
    desktop.expect("CAP Alt W")


def test_characters_of_altgr_are_on_no_key_cap(desktop: Desktop) -> None:
    desktop.use_layout("pl")
    try:
        desktop.do("key", "Return")
        desktop.expect("KEYS typing")
        desktop.do("keydown", "ISO_Level3_Shift", "key", "39", "key", "38", "keyup", "ISO_Level3_Shift")
        desktop.expect("TEXT ('śą', 2)")
        desktop.do("key", "ctrl+d")
        desktop.expect("KEYS driving", "CAP W")
        assert {line for line in desktop.since() if line.startswith("CAP")} <= {"CAP W", "CAP Alt W"}
    finally:
        desktop.use_layout("us")


def test_chords_work_by_position_on_a_keyboard_without_latin_letters(desktop: Desktop) -> None:
    desktop.use_layout("ru")
    try:
        desktop.do("keydown", "ctrl", "key", "46", "keyup", "ctrl")  # position of L
        desktop.expect("KEYS typing")
        desktop.do("key", "38")
        desktop.expect("TEXT ('ф', 1)")
        desktop.do("keydown", "ctrl", "key", "45", "keyup", "ctrl")  # K
        desktop.expect("PALETTE True")
        desktop.do("key", "Escape", "keydown", "ctrl", "key", "40", "keyup", "ctrl")  # D
        desktop.expect_all("PALETTE False", "KEYS driving")
        desktop.do("keydown", "25", "keyup", "25")
        desktop.expect(FORWARD, "release_drive")
    finally:
        desktop.use_layout("us")


def test_a_click_on_a_tab_or_a_bar_ends_driving_by_bare_keys(desktop: Desktop) -> None:
    for word, name, field in (
        ("title", "assistant", True),
        ("title", "session", False),
        ("where", "status_bar", False),
    ):
        desktop.do("key", "ctrl+d")
        x, y = desktop.place(word, name)
        desktop.do("mousemove", str(x), str(y), "click", "1", "sleep", "0.2")
        desktop.do("type", "--delay", "5", "was a wide road said")
        desktop.do("key", "space", "key", "F12")
        desktop.expect("silence")
        assert desktop.intents("drive") == [], name
        assert "KEYS typing" in desktop.since() if field else True
    assert not [line for line in desktop.since() if line.startswith(("open_scenario", "POPUP True", "say"))]


def test_a_name_for_nobody_goes_nowhere(desktop: Desktop) -> None:
    desktop.send_command("nobody")
    desktop.do("key", "Return")
    desktop.expect("KEYS typing")
    desktop.do("key", "ctrl+i")
    desktop.expect("KEYS nowhere")
    desktop.do("type", "--delay", "5", "Mara Wade")
    desktop.do("key", "Return", "key", "Escape")
    desktop.expect("stop", "KEYS typing")
    assert not desktop.intents("say") and not desktop.intents("drive")
    desktop.do("type", "--delay", "5", "hi")
    desktop.expect("TEXT ('hi', 2)")


def _nothing(_desktop: Desktop) -> None:
    pass


def _dialog(desktop: Desktop) -> None:
    desktop.send_command("dialog")
    desktop.expect_all("DIALOG True", "ACTIVE StartDialog", "KEYS dialog")


def _combo(desktop: Desktop) -> None:
    desktop.send_command("combo")
    desktop.expect("POPUP True", "KEYS menu")


def _completion(desktop: Desktop) -> None:
    desktop.send_command("completer")
    desktop.expect("KEYS typing")
    desktop.do("type", "he")
    desktop.expect("POPUP True")


def _floating(desktop: Desktop) -> None:
    desktop.send_command("float drive 700 500")
    desktop.do("sleep", "0.3")
    desktop.click("drive_line")
    desktop.expect("ACTIVE FloatingWindow")


SITUATIONS = {"nothing": _nothing, "dialog": _dialog, "combo": _combo, "completion": _completion, "floating": _floating}


@pytest.mark.parametrize("situation", SITUATIONS)
def test_every_stop_works(desktop: Desktop, whole_desktop: VirtualDesktop, situation: str) -> None:
    def fresh() -> Desktop:
        again = Desktop(whole_desktop)
        SITUATIONS[situation](again)
        return again

    desktop = fresh()
    desktop.do("key", "Escape")
    desktop.expect("stop")
    assert not desktop.intents("emergency_stop")
    if situation in ("dialog", "combo", "completion"):
        # The stop closes an open popup, and the field keeps the typed text.
        desktop.expect("DIALOG False" if situation == "dialog" else "POPUP False")
    desktop = fresh()
    desktop.do("keydown", "alt", "keydown", "shift", "key", "Escape", "keyup", "shift", "keyup", "alt")
    desktop.expect("stop")
    desktop = fresh()
    desktop.do("key", "--delay", "60", "Escape", "Escape")
    desktop.expect("stop", "emergency_stop")
    desktop = fresh()
    desktop.do("keydown", "alt", "keydown", "shift", "key", "Pause", "keyup", "shift", "keyup", "alt")
    desktop.expect("emergency_stop")
    desktop = fresh()
    desktop.click("emergency_stop_copy" if situation == "dialog" else "emergency_stop")
    desktop.expect("emergency_stop")
    assert len(desktop.intents("emergency_stop")) == 1


def test_an_escape_during_the_close_of_the_first_is_not_lost(whole_desktop: VirtualDesktop) -> None:
    for _ in range(5):  # one in three was sent to the closed window or treated as a repeat
        desktop = Desktop(whole_desktop)
        _completion(desktop)
        desktop.do("key", "--delay", "0", "Escape", "Escape")
        desktop.expect("stop", "emergency_stop")


@pytest.mark.parametrize("closing", ["Escape", "space"])
def test_no_stop_is_lost_while_the_keys_go_back_from_a_dialog(
    desktop: Desktop, whole_desktop: VirtualDesktop, closing: str
) -> None:
    desktop.send_command("keep_keys 60")
    _dialog(desktop)
    desktop.send_command("focus start_dialog_cancel")
    desktop.do("sleep", "0.1")
    with whole_desktop.busy_manager():  # before it moves the focus, no window would get the keys
        desktop.do("key", closing)
        desktop.expect("DIALOG False")
        desktop.do("key", "Escape")
        if closing == "space":
            desktop.expect("stop")
            desktop.do("key", "Escape")
        desktop.expect("emergency_stop")
    assert len(desktop.intents("stop")) == len(desktop.intents("emergency_stop")) == 1
    desktop.send_command("keep_keys 0.6")


@pytest.mark.parametrize("delay_ms", [4, 10, 20, 40])  # faster than any person
def test_two_quick_escapes_over_a_dialog_are_an_emergency_stop(whole_desktop: VirtualDesktop, delay_ms: int) -> None:
    for _ in range(4):
        desktop = Desktop(whole_desktop)
        _dialog(desktop)
        desktop.do("key", "--delay", str(delay_ms), "Escape", "Escape")
        desktop.expect("stop", "emergency_stop")
        assert len(desktop.intents("emergency_stop")) == 1


@pytest.mark.parametrize("delay_ms", [40, 160])
def test_an_escape_for_a_dialog_that_closed_meanwhile_counts(whole_desktop: VirtualDesktop, delay_ms: int) -> None:
    desktop = Desktop(whole_desktop)
    _dialog(desktop)
    desktop.send_command(
        "slow_stop 0.4"
    )  # the X server sends the second press to the dialog; Qt reads it after its end
    desktop.do("sleep", "0.1", "key", "--delay", str(delay_ms), "Escape", "Escape")
    desktop.expect("stop", "emergency_stop", "READY True", "KEYS driving")
    desktop.do("sleep", "0.2", "key", "Escape")
    desktop.expect("stop")  # the earlier press and release do not make it a repeat
    assert len(desktop.intents("emergency_stop")) == 1


def test_one_escape_that_closes_a_dialog_is_one_and_the_keys_are_the_windows_again(desktop: Desktop) -> None:
    _dialog(desktop)
    desktop.do("keydown", "Escape", "sleep", "0.3", "keyup", "Escape")
    desktop.expect("stop")
    desktop.expect_all("ACTIVE MainWindow", "KEYS driving")
    assert not desktop.intents("emergency_stop")
    other = desktop.start_other_program()
    try:
        desktop.expect("KEYS elsewhere", timeout_s=20.0)
        desktop.do("sleep", "0.8", "key", "F1")  # bound by another program
        other.terminate()
        other.wait(timeout=15)
        desktop.expect("KEYS driving")
        desktop.do("key", "F2")
        desktop.expect("say ('Please follow me.', 'phrase')")
        assert len(desktop.intents("say")) == 1
    finally:
        other.kill()
        other.wait(timeout=15)


def test_the_gamepad_drives_stops_and_speaks(desktop: Desktop, whole_desktop: VirtualDesktop) -> None:
    desktop.send_command("plug")
    desktop.expect("GAMEPAD True")
    desktop.send_command("pad push 1 -1.0")
    desktop.expect("drive (0.6, 0.0, 0.0, 'gamepad')")
    desktop.send_command("pad push 5 1.0")
    desktop.expect("drive (1.0, 0.0, 0.0, 'gamepad')")
    desktop.do("keydown", "a")
    desktop.expect("drive (1.0, 0.0, 1.0, 'keyboard')")
    desktop.do("keyup", "a")
    desktop.expect("drive (1.0, 0.0, 0.0, 'gamepad')")
    desktop.send_command("pad press 1")
    desktop.expect("stop")
    desktop.send_command("pad release 1")
    desktop.send_command("pad press 11")
    desktop.expect("say ('Hello! Welcome to the lab.', 'phrase')")
    desktop.send_command("pad release 11")
    assert len(desktop.intents("drive")) == 4, "the stick that was held through a stop does not drive on"
    desktop.send_command("pad push 1 0.0")
    # Gamepad stops work over every window; its stick drives over none.
    for number, situation in enumerate((_dialog, _combo, _completion, _floating)):
        desktop = Desktop(whole_desktop)
        situation(desktop)
        desktop.send_command("pad press 1")
        desktop.expect("stop")
        desktop.send_command("pad release 1")
        desktop.send_command("pad press 4")
        desktop.expect("emergency_stop")
        desktop.send_command("pad release 4")
        if number < 2:
            desktop = Desktop(whole_desktop)
            situation(desktop)
            desktop.send_command("pad push 1 -1.0")
            desktop.do("sleep", "0.2")
            assert not desktop.intents("drive")
            desktop.send_command("pad push 1 0.0")
            desktop.do("key", "Escape")
            desktop.expect("stop")
    desktop = Desktop(whole_desktop)
    desktop.send_command("pad push 0 -1.0")
    desktop.expect("drive (0.0, 0.0,")
    desktop.send_command("pad unplug")
    desktop.expect("release_drive The gamepad was unplugged")
    assert "GAMEPAD False" in desktop.since()


def test_a_key_that_the_window_manager_keeps_stops_too(desktop: Desktop) -> None:
    desktop.do("keydown", "w")
    desktop.expect(FORWARD)
    desktop.do("keydown", "ctrl", "keydown", "F11", "sleep", "0.1", "keyup", "F11", "keyup", "ctrl")
    desktop.expect("release_drive The window manager took over the keyboard")
    desktop.do("keyup", "w", "keydown", "w")
    desktop.expect(FORWARD)
    desktop.do("keydown", "ctrl", "keydown", "Escape", "sleep", "0.1", "keyup", "Escape", "keyup", "ctrl", "keyup", "w")
    desktop.expect("stop")


def test_a_completion_does_not_end_driving(desktop: Desktop) -> None:
    desktop.send_command("completer")
    desktop.expect("KEYS typing")
    desktop.do("keydown", "KP_Up")
    desktop.expect(FORWARD)
    desktop.do("type", "he")
    desktop.expect("POPUP True")
    assert not desktop.intents("release_drive")
    desktop.do("keydown", "alt", "keydown", "a")
    desktop.expect("drive (1.0, 0.0, 1.0, 'keyboard')")
    desktop.do("keyup", "KP_Up", "keyup", "a", "keyup", "alt")
    desktop.expect("release_drive")
    assert "TEXT ('he', 2)" in desktop.since()


def test_floating_panels_belong_to_the_window(desktop: Desktop) -> None:
    desktop.send_command("float speak 700 500")
    desktop.expect("ACTIVE FloatingWindow", "KEYS typing")  # focus stays with a panel that the user floats
    desktop.click("video_view")
    desktop.expect("ACTIVE MainWindow", "KEYS driving")
    desktop.do("sleep", "0.3", "keydown", "alt", "keydown", "w")
    desktop.expect(FORWARD)
    desktop.click("speak_field")  # the main window is deactivated, the key stays pressed
    desktop.expect("ACTIVE FloatingWindow", "KEYS typing")
    assert not desktop.intents("release_drive")
    desktop.do("keyup", "alt")
    desktop.do("type", "hi")
    desktop.expect("TEXT ('hi', 2)")
    desktop.do("keyup", "w")
    desktop.expect("release_drive")
    desktop.do("keydown", "alt", "keydown", "a")
    desktop.expect(LEFT)
    other = desktop.start_other_program()
    try:
        desktop.expect("release_drive", "KEYS elsewhere")
    finally:
        desktop.do("keyup", "a", "keyup", "alt")
        other.terminate()
        other.wait(timeout=10)


@pytest.mark.parametrize("loss", ["another program", "a dialog", "another workspace", "the speak field"])
def test_a_key_whose_release_is_lost_has_to_be_pressed_again(desktop: Desktop, loss: str) -> None:
    desktop.do("keydown", "w")
    desktop.expect(FORWARD)
    other = None
    match loss:
        case "another program":
            other = desktop.start_other_program()
        case "a dialog":
            desktop.send_command("dialog")
        case "another workspace":
            desktop.do("set_desktop", "1")
        case _:
            desktop.send_command("focus speak_field")
    desktop.expect("release_drive")
    lost = desktop.at
    desktop.do("sleep", "0.7", "keyup", "w")
    if other is not None:
        other.terminate()
        other.wait(timeout=10)
    if loss == "another workspace":
        desktop.do("set_desktop", "0")
        desktop.expect("KEYS driving")
    desktop.do("sleep", "0.2", "key", "Escape")
    desktop.expect("stop")
    assert not [line for line in desktop.since(lost) if line.startswith("drive")]
    if loss == "the speak field":
        assert "TEXT ('w" not in "\n".join(desktop.since())
        desktop.do("key", "ctrl+d")
    desktop.do("keydown", "w")
    desktop.expect(FORWARD)
    desktop.do("keyup", "w")
    desktop.expect("release_drive")


def test_qt_had_nothing_to_complain_about(whole_desktop: VirtualDesktop) -> None:
    words = ("arning", "rror", "Traceback", "QObject", "qt.")
    told = [line for line in whole_desktop.lines() if not line.startswith("mark ")]  # of a wizard error
    assert not [line for line in told if any(word in line for word in words)]


AS_IT_WAS = "LAYOUT video speak map drive assistant+session people"  # cards may cover the lower right corner


def test_a_tab_that_is_dragged_leaves_its_group_alone_and_goes_where_it_is_dropped(desktop: Desktop) -> None:
    x, y = desktop.place("title", "map")
    middle = desktop.place("where", "video_view")
    desktop.drag((x, y), (x - 40, y + 30), middle)
    desktop.expect("LAYOUT video+map speak drive assistant+session people")
    desktop.drag(desktop.place("title", "drive"), middle)
    desktop.expect("LAYOUT video+map+drive speak assistant+session people")
    left, lower = desktop.place("title", "speak")
    desktop.drag(desktop.place("title", "map"), middle, (left - 30, lower + 90))
    desktop.expect("LAYOUT video+drive map speak assistant+session people")


def test_a_panel_is_dragged_out_of_the_window_and_put_back_by_its_button(desktop: Desktop) -> None:
    x, y = desktop.place("title", "map")
    desktop.drag((x, y), (x, y + 60), (1330, 830))
    desktop.expect("LAYOUT video speak drive assistant+session people ~ map")
    desktop.do("sleep", "0.3")
    x, y = desktop.place("float_button", "map")
    desktop.do("mousemove", str(x), str(y), "click", "1")
    desktop.expect(AS_IT_WAS)


def test_escape_while_dragging_leaves_the_panel_where_it_was_and_stops_the_robot(desktop: Desktop) -> None:
    x, y = desktop.place("title", "map")
    desktop.do("mousemove", str(x), str(y), "mousedown", "1", "mousemove", str(x - 300), str(y + 100))
    desktop.do("key", "Escape", "mouseup", "1")
    desktop.expect("stop")
    desktop.drag(desktop.place("title", "drive"), (x - 300, y + 150), desktop.place("where", "video_view"))
    desktop.expect("LAYOUT video+drive speak map assistant+session people")
    assert sum(line.startswith("LAYOUT") for line in desktop.since()) <= 1, "only the second drag did anything"


def test_locked_panels_cannot_be_dragged(desktop: Desktop) -> None:
    desktop.send_command("lock on")
    desktop.expect("LOCKED on")
    desktop.drag(desktop.place("title", "map"), desktop.place("where", "video_view"))
    desktop.send_command("lock off")
    desktop.expect("LOCKED off")
    desktop.drag(desktop.place("title", "drive"), desktop.place("where", "video_view"))
    desktop.expect("LAYOUT video+drive speak map assistant+session people")
    assert sum(line.startswith("LAYOUT") for line in desktop.since()) == 1
