"""Choice of a language model file to add."""

from collections.abc import Callable
from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QFileDialog, QWidget

from caris_desktop.conversation.models.embedded_models import SUFFIX
from caris_desktop.domain.intents import AddModel, Intent
from caris_desktop.domain.translation import tr


def choose_model_file(window: QWidget, do: Callable[[Intent], object]) -> None:
    """Open a dialog whose file is added.

    Not modal and not the system's, which would take the keys that stop the robot.
    """
    dialog = QFileDialog(
        window, tr("Add a model file"), str(Path.home()), tr("Language models ({files})").format(files=f"*{SUFFIX}")
    )
    dialog.setObjectName("model_file_dialog")
    dialog.setOption(QFileDialog.Option.DontUseNativeDialog)
    dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
    dialog.setModal(False)
    dialog.setFileMode(QFileDialog.FileMode.ExistingFile)
    dialog.fileSelected.connect(lambda chosen: do(AddModel(Path(chosen))))
    dialog.show()
