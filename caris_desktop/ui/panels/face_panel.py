"""Face panel: the robot's face as the participant sees it, and the expressions with their keys."""

from functools import partial

from PySide6.QtCore import QSize, Qt
from PySide6.QtGui import QGuiApplication
from PySide6.QtWidgets import QSizePolicy, QWidget

from caris_desktop.conversation.face.drawing import FaceMotion, drawing_of
from caris_desktop.conversation.face.face_file import Face, FaceError, load_face
from caris_desktop.domain import intents
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.status import FaceStatus
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.action_rows import EXPRESSION_COUNT
from caris_desktop.ui.face_window import FaceView, show_on
from caris_desktop.ui.panel import Panel, PanelContext
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import FlowRow
from caris_desktop.ui.widgets.inputs import SubmitLineEdit
from caris_desktop.ui.widgets.labels import label

_LOW_PX, _NARROW_PX = 330, 480


class FacePanel(Panel):
    """Displays ``state.face_drawing``; in a replay, the face at rest."""

    title = QT_TR_NOOP("Robot’s face")
    preferred_size, least_size = QSize(360, 320), QSize(200, 140)
    reads = ()

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("face_panel")
        self._view = FaceView()
        self._view.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Expanding)
        self._view.setMinimumHeight(60)
        self._row = FlowRow(gap_px=6)
        self._chips: list[ActionButton] = []
        self._recorded: Face | None = None
        self._text = SubmitLineEdit(
            objectName="face_text", placeholderText=tr("Show text instead…"), maxLength=200, returnPressed=self._on_text
        )
        self._text.setAccessibleName(tr("Text to show instead of the face"))
        hint_px = self._text.fontMetrics().horizontalAdvance(self._text.placeholderText())
        self._text.setMinimumWidth(max(180, hint_px + 28))
        button = partial(ActionButton, self.theme, height_px=30)
        self._back = button(tr("Show face"), icon="smiley", objectName="face_again", clicked=self._on_back)
        self._live = button(tr("Live picture"), icon="video-camera", objectName="face_live", clicked=self._on_live)
        self._window = button(tr("Window"), icon="monitor", objectName="face_window_button", clicked=self._on_window)
        self._window.setToolTip(tr("Show the face in a separate window, for a screen on the robot"))
        self._page = button(tr("Page"), icon="device-mobile", objectName="face_page_button", clicked=self._on_serve)
        self._page.setToolTip(tr("Serve the face as a web page, for a phone or tablet on the robot"))
        for served in (self._window, self._page):
            served.setCheckable(True)
        copy = tr("Copy the address")
        self._copy = button(copy, icon="copy", objectName="face_copy_address", clicked=self._on_copy)
        self._edit = button(tr("Edit…"), icon="pencil-simple", objectName="face_edit", clicked=self._on_edit)
        self._address = label("", "note", wraps=True, objectName="face_address")
        self._address.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self._more = FlowRow(self._text, self._back, self._live, self._copy, self._edit, gap_px=6)
        rest = layouts.vbox(None, self._row, self._more, self._address, margins_px=(12, 0, 12, 0), spacing_px=8)
        layouts.vbox(self, (self._view, 1), rest, margins_px=(2, 0, 2, 8), spacing_px=8)
        self._row.setVisible(self.state.present.live)
        self.watch(self._on_face, self.state.face.changed)
        self.watch(self._on_drawing, self.state.face_drawing.changed)
        self.state.face_page.changed.connect(self._on_page)
        self.table.rows_changed.connect(self._fill)
        self._fill()
        self.update_view()

    def show_scenario(self) -> None:
        self._text.clear()
        self._fill()
        super().show_scenario()

    def title_widgets(self) -> list[QWidget]:
        return [self._window, self._page] if self.state.present.live else []

    def fit(self) -> None:
        self._show_more()
        for chip in self._chips:
            self._fit(chip)
        for button, words in ((self._window, tr("Window")), (self._page, tr("Page"))):
            button.set_label(words if self.width() >= _NARROW_PX else "", name=words)

    def _show_more(self) -> None:
        """Hide rarely used controls if space is short, except the way back to the face."""
        elsewhere = self.state.face.value.what not in ("face", "off")
        self._more.setVisible(self.state.present.live and (self.height() >= _LOW_PX or elsewhere))

    def _fit(self, chip: ActionButton) -> None:
        low = self.height() < _LOW_PX
        chip.set_size(height_px=26 if low else 30, text_px=tokens.STATUS_PX if low else tokens.BODY_PX)

    def update_view(self) -> None:
        self._on_face(self.state.face.value)
        self._on_drawing(self.state.face_drawing.value)
        self._on_page(self.state.face_page.value)

    def _fill(self) -> None:
        """Create a button per expression of this face, with its key."""
        ids = [f"expression_{number}" for number in range(1, EXPRESSION_COUNT + 1)]
        specs = [spec for spec in map(self.table.spec, ids) if spec is not None]
        names = self.state.face.value.expressions[: len(specs)]
        if [chip.objectName() for chip in self._chips] == [spec.id for spec in specs] and all(
            chip.text() == name for chip, name in zip(self._chips, names, strict=False)
        ):
            return
        for chip in self._chips:
            self._row.remove(chip)
            chip.deleteLater()
        self._chips = []
        for spec, name in zip(specs, names, strict=False):
            chip = ActionButton(self.theme, spec.text, key_first=True, height_px=30, may_shrink=True)
            chip.setObjectName(spec.id)
            chip.bind(self.table, spec.id)
            chip.set_label(name)
            self._fit(chip)
            self._row.add(chip)
            self._chips.append(chip)

    def _on_face(self, face: FaceStatus) -> None:
        doing = tr("speaking") if face.speaking else tr("listening") if face.listening else ""
        words = {"text": tr("showing text"), "photo": tr("showing a photo"), "live": tr("showing the live picture")}
        face_text = words.get(face.what, face.expression)
        fact = " · ".join(part for part in (doing, face_text) if part) if face.what != "off" else ""
        screens = face.pages + (1 if face.window else 0)
        if self.state.present.live and face.what != "off" and not screens:
            fact = " · ".join((fact, tr("not on a screen")))
        self.set_fact(fact, "blue" if doing else "dim")
        self._window.setChecked(face.window)
        self._page.setChecked(face.served)
        self._back.setVisible(face.what not in ("face", "off"))
        self._show_more()
        self._live.setVisible(self.console.scenario.face.live_picture and face.what != "live")
        if not self.state.present.live:
            self._show_at_rest(face)

    def _show_at_rest(self, face: FaceStatus) -> None:
        if self._recorded is None or self._recorded.name != face.face:
            try:
                self._recorded = load_face(face.face)
            except FaceError:
                return  # a face of another computer
        motion = FaceMotion(self._recorded)
        motion.express(face.expression)
        self._view.show_drawing(drawing_of(self._recorded, motion.at(0)))

    def _on_drawing(self, contents: object) -> None:
        if self.state.present.live:
            show_on(self._view, contents)

    def _on_page(self, address: str) -> None:
        self._address.setText(
            tr("Open this on the robot’s screen: {address}").format(address=address) if address else ""
        )
        self._address.setVisible(bool(address))
        self._copy.setVisible(bool(address))

    def _on_text(self) -> None:
        text = self._text.text().strip()
        if text and not self.console.do(intents.ShowOnFace("text", text)):
            self._text.clear()

    # Methods: a connected closure would outlive the window where the button is never shown.

    def _on_back(self) -> None:
        self.console.do(intents.ShowOnFace("face"))

    def _on_live(self) -> None:
        self.console.do(intents.ShowOnFace("live"))

    def _on_window(self, on: bool) -> None:
        self.console.do(intents.ShowFaceWindow(on))

    def _on_serve(self, on: bool) -> None:
        self.console.do(intents.ServeFace(on))

    def _on_copy(self) -> None:
        QGuiApplication.clipboard().setText(self.state.face_page.value)

    def _on_edit(self) -> None:
        self.window_requested.emit("face")
