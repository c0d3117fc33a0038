"""Import and export of scenarios as one file: file dialogs and questions. The console does the work."""

from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QDialog, QFileDialog, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.translation import tr
from caris_desktop.live.confirmed_files import FileQuestion
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.bundle import SUFFIX, ImportQuestion, bundle_name
from caris_desktop.ui.theme import Theme


class ScenarioFiles:
    """Non-modal Qt dialogs: a system file dialog would take the keys that stop the robot."""

    def __init__(self, console: WizardConsole, window: QWidget, theme: Theme) -> None:
        self._console = console
        self._window = window
        self._theme = theme
        self._shown_question: QDialog | None = None
        console.state.import_question.changed.connect(self._ask)
        console.state.file_question.changed.connect(self._ask_to_confirm)

    def choose_import(self) -> None:
        dialog = self._dialog(tr("Import a scenario"), Path.home())
        dialog.setFileMode(QFileDialog.FileMode.ExistingFile)
        dialog.fileSelected.connect(lambda chosen: self._console.do(intents.ImportScenario(Path(chosen))))
        dialog.show()

    def _ask(self, question: ImportQuestion | None) -> None:
        """Ask about name conflicts. Cancel changes nothing."""
        if question is None:
            return
        # Imported late: the first window does not need it.
        from caris_desktop.ui.import_conflict_dialog import ImportConflictDialog

        def decide(decided: tuple[intents.SameName, ...]) -> None:
            self._console.do(intents.ImportScenario(question.path, decided))

        ImportConflictDialog(self._theme, self._window, question, decide).show()

    def _ask_to_confirm(self, question: FileQuestion | None) -> None:
        """List the references of a file. Nothing in the file is used before a yes; closing the dialog means no."""
        if self._shown_question is not None:
            previous, self._shown_question = self._shown_question, None
            previous.close()
        if question is None:
            return
        # Imported late: the first window does not need it.
        from caris_desktop.ui.confirm_file_dialog import ConfirmFileDialog

        def answer(accepted: bool) -> None:
            self._shown_question = None
            self._console.do(intents.ConfirmFile(question.sha256, accepted))
            if accepted:
                self._console.do(question.then)

        dialog = self._shown_question = ConfirmFileDialog(self._theme, self._window, question)
        dialog.finished.connect(lambda result: answer(result == QDialog.DialogCode.Accepted))
        dialog.show()

    def choose_share(self) -> None:
        scenario = self._console.scenario
        stem = bundle_name(scenario.path.stem if scenario.path is not None else scenario.title)
        dialog = self._dialog(tr("Export this scenario as one file"), Path.home())
        dialog.setAcceptMode(QFileDialog.AcceptMode.AcceptSave)
        dialog.setDefaultSuffix(SUFFIX.removeprefix("."))
        dialog.selectFile(f"{stem}{SUFFIX}")
        dialog.fileSelected.connect(lambda chosen: self._console.do(intents.ShareScenario(Path(chosen))))
        dialog.show()

    def _dialog(self, title: str, folder: Path) -> QFileDialog:
        dialog = QFileDialog(self._window, title, str(folder), tr("Scenarios ({files})").format(files=f"*{SUFFIX}"))
        dialog.setObjectName("scenario_file_dialog")
        dialog.setOption(QFileDialog.Option.DontUseNativeDialog)
        dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        dialog.setModal(False)
        return dialog
