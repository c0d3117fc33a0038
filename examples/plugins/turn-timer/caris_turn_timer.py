"""Panel for CARIS Desktop: the time since somebody last spoke, and a button that marks a long silence."""

from PySide6.QtCore import QElapsedTimer, QTimer
from PySide6.QtWidgets import QLabel, QPushButton, QVBoxLayout, QWidget

from caris_desktop.domain.events import UtteranceChanged
from caris_desktop.domain.intents import Mark


class TurnTimer(QWidget):
    """The contract is ``caris_desktop.ui.plugin_panel.PanelPlugin``."""

    caris_interface = 1

    def __init__(self, console):
        super().__init__()
        self._console = console
        self._speaking = set()
        self._silence = QElapsedTimer()
        self._shown = QLabel("Nobody has spoken yet.")
        mark = QPushButton("Mark silence")
        mark.clicked.connect(lambda: console.request(Mark(label="silence")))
        rows = QVBoxLayout(self)
        rows.addWidget(self._shown)
        rows.addWidget(mark)
        console.follow(UtteranceChanged, self._on_utterance)
        clock = QTimer(self, interval=500)
        clock.timeout.connect(self._show_silence)
        clock.start()

    def _on_utterance(self, utterance):
        if utterance.state == "started":
            self._speaking.add(utterance.utterance_id)
            self._shown.setText(f"Speaking: {utterance.speaker}")
        elif utterance.utterance_id in self._speaking:
            self._speaking.remove(utterance.utterance_id)
            self._silence.start()

    def _show_silence(self):
        if not self._speaking and self._silence.isValid():
            self._shown.setText(f"Silent for {self._silence.elapsed() / 1000:.0f} s")
