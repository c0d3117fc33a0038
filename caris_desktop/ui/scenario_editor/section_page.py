"""Form page of one section, built when first shown."""

from PySide6.QtCore import Qt, QTimer
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QFrame, QLabel, QScrollArea, QVBoxLayout, QWidget

from caris_desktop.domain.key_path import KeyPath
from caris_desktop.domain.translation import tr
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.scenario_editor.arranging import show_at_once
from caris_desktop.ui.scenario_editor.editing_context import FormContext
from caris_desktop.ui.scenario_editor.groups import part_for
from caris_desktop.ui.scenario_editor.sections import Section
from caris_desktop.ui.scenario_editor.value_fields import Field, FormPart

_WIDEST_PX, _LEAST_WORDS_PX, _SIDE_PX = 900, 200, 24


class SectionPage(QScrollArea):
    """Form page; refreshes only while visible."""

    def __init__(self, context: FormContext, section: Section) -> None:
        super().__init__()
        self.section = section
        self._context = context
        self.parts: list[FormPart] = []
        self._column: QVBoxLayout | None = None
        self._stale = False
        self._next = QTimer(self, singleShot=True, interval=0)
        self._next.timeout.connect(self._make_next)
        self.setObjectName("section_page")
        self.setWidgetResizable(True)
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        context.theme.changed.connect(self._style)
        context.editing.changed.connect(self._on_changed)

    def build(self) -> None:
        """Create all fields now."""
        self._begin()
        while len(self.parts) < len(self.section.keys):
            self._make_next()
        if self._stale:
            self.refresh()

    def _begin(self) -> None:
        if self._column is not None:
            return
        holder = QWidget()
        holder.setObjectName("section_holder")
        column = layouts.vbox(holder, margins_px=(_SIDE_PX, 16, _SIDE_PX, 24), spacing_px=20)
        self._title = QLabel(tr(self.section.title))
        self._words = QLabel(tr(self.section.words), wordWrap=True, textFormat=Qt.TextFormat.PlainText)
        column.addWidget(self._title)
        if self.section.words:
            column.addWidget(self._words)
        column.addStretch(1)
        self._column = column
        self.setWidget(holder)
        self._style()

    def _make_next(self) -> None:
        """Create one field per event loop turn, so that keys are still handled."""
        if len(self.parts) == len(self.section.keys) or self._column is None:
            return
        key = self.section.keys[len(self.parts)]
        part = part_for(self._context, (key.name,), key)
        part.setMaximumWidth(_WIDEST_PX)
        self.parts.append(part)
        self._column.insertWidget(self._column.count() - 1, part)
        show_at_once(part)
        part.refresh()
        if len(self.parts) < len(self.section.keys):
            self._next.start()

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        if self._column is not None:
            self._fit_words()

    def _fit_words(self) -> None:
        """Fit the explanation to the visible width, however wide the lists are."""
        room_px = max(_LEAST_WORDS_PX, self.viewport().width() - 2 * _SIDE_PX)
        self._words.setMaximumWidth(room_px)
        self._words.setMinimumHeight(self._words.heightForWidth(room_px))

    def refresh(self) -> None:
        self._stale = False
        for part in self.parts:
            part.refresh()
        self.setEnabled(self._context.editing.document.unreadable is None)

    def _on_changed(self) -> None:
        self._stale = True
        if self.isVisible():
            self.refresh()

    def showEvent(self, event: object) -> None:
        self._begin()
        self._next.start()
        if self._stale:
            self.refresh()
        super().showEvent(event)  # type: ignore[arg-type]

    def reveal(self, path: KeyPath) -> Field | None:
        """Field of a path, or of the closest enclosing one."""
        self.build()
        for cut in range(len(path), 0, -1):
            for part in self.parts:
                if path[:1] == part.path:
                    field = part.reveal(path[:cut])
                    if field is not None:
                        return field
        return None

    def _style(self) -> None:
        if self._column is not None:
            theme = self._context.theme
            self._title.setFont(theme.font(tokens.SPEECH_PX + 2, tokens.WEIGHT_SEMIBOLD))
            theme.style_text(self._words, "dim", tokens.BODY_PX)
            self._fit_words()
