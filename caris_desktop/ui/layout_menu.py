"""Layout menu: undo, save, revert, reset, lock."""

from PySide6.QtWidgets import QDialog, QDialogButtonBox, QLabel, QLineEdit, QMenu, QVBoxLayout, QWidget

from caris_desktop.domain.intents import SizeClass
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.scenario.scenario_model import PanelName
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.layout_store import LayoutStore
from caris_desktop.ui.panel_manager import PanelManager
from caris_desktop.ui.tab_order import VisualTabOrderMixin
from caris_desktop.ui.text_formatting import in_menu
from caris_desktop.ui.theme import Theme

_LONGEST_TITLE = 80
_UNDO_AND_REDO = 2
_SIZES: dict[SizeClass, str] = {
    "compact": QT_TR_NOOP("For a small screen"),
    "usual": QT_TR_NOOP("For a medium-sized screen"),
    "large": QT_TR_NOOP("For a large screen"),
}


class LayoutMenu:
    """Fills a menu each time it opens."""

    def __init__(
        self, keeper: LayoutStore, board: PanelManager, actions: Actions, theme: Theme, window: QWidget
    ) -> None:
        self._keeper = keeper
        self._actions = actions
        self._board = board
        self._theme = theme
        self._window = window
        keeper.title_wanted.connect(self._ask_title)

    def title(self) -> str:
        return tr("Layout (changed, not saved)") if self._keeper.is_unsaved else tr("Layout")

    def fill(self, menu: QMenu) -> None:
        keeper = self._keeper
        menu.setObjectName("layout_menu")
        # Some styles do not show section titles.
        menu.addAction(tr(_SIZES[keeper.kind])).setEnabled(False)
        menu.addSeparator()
        for number, command in enumerate(keeper.commands()):
            if number == _UNDO_AND_REDO:
                menu.addSeparator()
            key = self._actions.key_text(command.action) if command.action else ""
            action = menu.addAction("\t".join(part for part in (in_menu(command.text), key) if part))
            action.setEnabled(command.possible)
            action.triggered.connect(keeper.soon(command.do))
        menu.addSeparator()
        focused = self._focused_panel()
        if focused is not None:
            self._board.fill_panel_menu(menu.addMenu(tr("Focused panel")), focused)
        locked = menu.addAction(tr("Lock for a study"))
        locked.setCheckable(True)
        locked.setChecked(keeper.locked)
        locked.triggered.connect(keeper.set_locked)
        adapts = menu.addAction(tr("Adapt to small and large screens"))
        adapts.setCheckable(True)
        adapts.setChecked(keeper.adapts)
        adapts.triggered.connect(keeper.set_adapts)

    def _focused_panel(self) -> PanelName | None:
        return next((name for name, panel in self._board.panels.items() if panel.active), None)

    def _ask_title(self) -> None:
        dialog = TitleDialog(self._theme, self._window)
        dialog.accepted.connect(lambda: self._keeper.save_as(dialog.title))
        dialog.show()


class TitleDialog(VisualTabOrderMixin, QDialog):
    """Title dialog of a new scenario. Non-modal: the robot can be driven and stopped meanwhile."""

    def __init__(self, theme: Theme, parent: QWidget) -> None:
        super().__init__(parent)
        self.setObjectName("layout_title_dialog")
        self.setWindowTitle(tr("Save as another scenario"))
        column = QVBoxLayout(self)
        words = QLabel(
            tr(
                "The new scenario contains everything in this one, with the current panel layout. What should it be "
                "called?"
            )
        )
        words.setWordWrap(True)
        self._field = QLineEdit(maxLength=_LONGEST_TITLE)
        self._field.setObjectName("layout_title_field")
        self._field.setAccessibleName(tr("Title of the new scenario"))
        buttons = QDialogButtonBox(QDialogButtonBox.StandardButton.Save | QDialogButtonBox.StandardButton.Cancel)
        self._save = buttons.button(QDialogButtonBox.StandardButton.Save)
        self._save.setEnabled(False)
        self._field.textChanged.connect(lambda text: self._save.setEnabled(bool(text.strip())))
        buttons.accepted.connect(self.accept)
        buttons.rejected.connect(self.reject)
        for part in (words, self._field, buttons):
            part.setFont(theme.font())
            column.addWidget(part)
        self.setMinimumWidth(420)
        self.finished.connect(self.deleteLater)

    @property
    def title(self) -> str:
        return " ".join(self._field.text().split())
