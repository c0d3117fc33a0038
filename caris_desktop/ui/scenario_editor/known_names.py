"""Names that fields may reference outside the file: of the connected robot, its face, and existing files."""

from PySide6.QtCore import QObject

from caris_desktop.domain.schema_fields import Known
from caris_desktop.domain.schema_paths import value_at
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.gestures import LOOK, NOD
from caris_desktop.ui.background_reading import read_for
from caris_desktop.ui.scenario_editor.editing_context import Editing, Names
from caris_desktop.ui.scenario_editor.opened_scenario import names_of_files

_DONE_AT_ONCE = ("button", "toggle")
"""Kinds of controls that a phrase can trigger: others need a value."""


class KnownNames(QObject):
    """Known names for the form of ``editing``; files are listed in a background thread."""

    def __init__(self, console: WizardConsole, editing: Editing) -> None:
        super().__init__(editing)
        self._state = console.state
        self._editing = editing
        self._files: dict[Known, tuple[str, ...]] = {}
        read_for(self, console, names_of_files, self._on_read)

    def _on_read(self, files: dict[Known, tuple[str, ...]]) -> None:
        self._files = files
        self._editing.emit_changes()

    def of(self, kind: Known) -> Names:
        state, data = self._state, self._editing.document.data
        if kind == "gestures":
            controls = data.get("controls")
            own = [
                value_at(each, ("id",))
                for each in (controls if isinstance(controls, list) else ())
                if value_at(each, ("kind",)) in _DONE_AT_ONCE
            ]
            robots = [control.id for control in state.controls.value if control.kind in _DONE_AT_ONCE]
            found = tuple(dict.fromkeys(name for name in (NOD, LOOK, *own, *robots) if isinstance(name, str)))
            return Names(found, state.link.value.state == "connected")
        if kind == "expressions":
            return Names(
                state.face.value.expressions, self._editing.document.value(("face", "face")) == state.face.value.face
            )
        # A robot may also be an address.
        return Names(self._files.get(kind, ()), kind == "faces" and kind in self._files)
