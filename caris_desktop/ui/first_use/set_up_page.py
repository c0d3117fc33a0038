"""Set-up page of the first start: try the program, or connect everything. Not a dialog: the red button stays usable."""

from collections.abc import Callable

from PySide6.QtCore import QRect, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QFontMetrics, QMouseEvent, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import (
    QAbstractButton,
    QBoxLayout,
    QButtonGroup,
    QHBoxLayout,
    QLabel,
    QSizePolicy,
    QStackedWidget,
    QWidget,
)

from caris_desktop.domain.events import PreflightState
from caris_desktop.domain.translation import tr
from caris_desktop.live.status import PreflightCheck
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.first_use.step_pages import StepPage, page_maker
from caris_desktop.ui.first_use.steps import SetUpStep, StepName, steps_for
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.overlay import Overlay
from caris_desktop.ui.preflight.preflight_words import ICONS, ROLES, STATES, worst
from caris_desktop.ui.robot_choice import RobotChooser
from caris_desktop.ui.text_formatting import ESC_CLOSES
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.scroll_areas import Scrolled

_WIDTH_PX, _WELCOME_PX, _HEIGHT_PX, _STEPS_PX = 880, 430, 600, 220
_BESIDE_FROM_PX, _NARROW_STEPS_PX = 700, 184


class SetUpPage(Overlay):
    """``simulated_requested``: try the simulated robot; ``finished(bool)``: closed, True if all steps are complete."""

    simulated_requested = Signal()
    finished = Signal(bool)

    def __init__(self, theme: Theme, window: QWidget, console: WizardConsole, robots: RobotChooser) -> None:
        super().__init__(theme, window, width_px=_WIDTH_PX)
        self.setObjectName("first_use")
        self.setAccessibleName(tr("Set up"))
        self._console = console
        self._make_page = page_maker(theme, console, robots)
        self._through = False
        self._pages = QStackedWidget()
        self._pages.addWidget(self._make_welcome())
        column = layouts.vbox(self.card, margins_px=(28, 22, 28, 20))
        column.addWidget(self._pages)
        self._steps: tuple[SetUpStep, ...] = ()
        self._step_buttons: dict[StepName, StepButton] = {}
        self._step_page: QWidget | None = None
        console.state.preflight.changed.connect(self._show_checks)

    @property
    def step(self) -> StepName | None:
        """Current step; None on the welcome page."""
        page = self._stack.currentWidget() if self._step_page is not None else None
        on_show = self._pages.currentWidget() is self._step_page
        return page.step.name if on_show and isinstance(page, StepPage) else None

    def open_welcome(self) -> None:
        self._through = False
        self._pages.setCurrentIndex(0)
        self.open()
        self._simulated.setFocus(Qt.FocusReason.TabFocusReason)

    def card_height_px(self) -> int:
        return _WELCOME_PX if self._pages.currentIndex() == 0 else _HEIGHT_PX

    def _place(self) -> None:
        super()._place()
        narrow = self.card.width() < _BESIDE_FROM_PX
        for choice in self._choice_buttons:
            choice.set_low(narrow)
        if self._step_page is not None:
            self._rail.setFixedWidth(_NARROW_STEPS_PX if narrow else _STEPS_PX)
        self._choices.setDirection(QBoxLayout.Direction.TopToBottom if narrow else QBoxLayout.Direction.LeftToRight)

    def close_overlay(self) -> None:
        if not self.isHidden():
            super().close_overlay()
            self.finished.emit(self._through)

    def mousePressEvent(self, event: QMouseEvent) -> None:
        event.accept()  # a click outside does not close it

    # Welcome

    def _make_welcome(self) -> QWidget:
        theme = self._theme
        page = QWidget()
        heading = QLabel(tr("Welcome"))
        heading.setFont(theme.font(24, tokens.WEIGHT_SEMIBOLD))
        about = QLabel(tr("Drive a robot, see what it sees and speak through it. How would you like to start?"))
        about.setWordWrap(True)
        self._simulated = ChoiceButton(
            theme, tr("Try it with the simulated robot"),
            tr("A robot, rooms and people on this computer. Nothing can break, and you can drive within seconds."),
            "rocket-launch", primary=True,
        )  # fmt: skip
        self._simulated.setObjectName("first_use_simulated")
        self._simulated.clicked.connect(self._on_simulated)
        robot_button = ChoiceButton(
            theme, tr("Connect my robot"),
            tr("Set up robot, camera, sound and language model step by step. Each step is tested, and you can "
                "do it later."),
            "robot",
        )  # fmt: skip
        robot_button.setObjectName("first_use_own")
        robot_button.clicked.connect(self._on_own)
        later = ActionButton(theme, tr("Not now"), key="Esc", role="ghost")
        later.setToolTip(tr(ESC_CLOSES))
        later.setObjectName("first_use_later")
        later.clicked.connect(self.close_overlay)
        again = QLabel(tr("You can find this again in the Window menu: Set up."), wordWrap=True)
        again.setFont(theme.font(tokens.STATUS_PX))
        self._choices = choices = QBoxLayout(QBoxLayout.Direction.LeftToRight)
        choices.setSpacing(16)
        choices.addWidget(self._simulated)
        choices.addWidget(robot_button)
        self._choice_buttons = (self._simulated, robot_button)
        foot = QHBoxLayout()
        foot.addWidget(again, 1)
        foot.addWidget(later)
        column = layouts.vbox(page, margins_px=0, spacing_px=12)
        content = QWidget()
        upper = layouts.vbox(content, margins_px=0, spacing_px=12)
        upper.addWidget(heading)
        upper.addWidget(about)
        upper.addStretch(1)
        upper.addLayout(choices)
        upper.addStretch(2)
        column.addWidget(Scrolled(content), 1)
        column.addLayout(foot)
        return page

    def _on_simulated(self) -> None:
        self._through = True
        self.simulated_requested.emit()
        self.close_overlay()

    def _on_own(self) -> None:
        self._build_steps()
        self.show_step(self._steps[0].name)

    # Steps

    def _build_steps(self) -> None:
        """Rebuilt each time: steps depend on the scenario."""
        if self._step_page is not None:
            self._pages.removeWidget(self._step_page)
            self._step_page.deleteLater()
        theme, page = self._theme, QWidget()
        self._steps = steps_for(self._console.state.preflight.value)
        self._stack = QStackedWidget()
        group = QButtonGroup(page)
        side = layouts.vbox(spacing_px=4)
        self._step_buttons = {}
        for step in self._steps:
            button = self._step_buttons[step.name] = StepButton(theme, tr(step.title))
            button.setObjectName(f"first_use_to_{step.name}")
            button.clicked.connect(self._shower(step.name))
            group.addButton(button)
            side.addWidget(button)
            self._stack.addWidget(self._make_page[step.name](step))
        side.addStretch(1)
        self._back = ActionButton(theme, tr("Back"), icon="caret-left", role="ghost")
        self._back.setObjectName("first_use_back")
        self._back.clicked.connect(self._on_back)
        self._next = ActionButton(theme, tr("Next"), role="primary")
        self._next.setObjectName("first_use_next")
        self._next.clicked.connect(self._on_next)
        foot = QHBoxLayout()
        foot.addWidget(self._back)
        foot.addStretch(1)
        close = ActionButton(theme, tr("Close"), key="Esc", role="ghost")
        close.setToolTip(tr(ESC_CLOSES))
        close.setObjectName("first_use_close")
        close.clicked.connect(self.close_overlay)
        foot.addWidget(close)
        foot.addWidget(self._next)
        rail = self._rail = QWidget()
        rail.setLayout(side)
        rail.setFixedWidth(_STEPS_PX)
        side.setContentsMargins(0, 0, 0, 0)
        upper = layouts.hbox(spacing_px=28)
        upper.addWidget(rail)
        upper.addWidget(self._stack, 1)
        column = layouts.vbox(page, margins_px=0)
        content = QWidget()
        content.setLayout(upper)
        upper.setContentsMargins(0, 0, 8, 0)
        column.addWidget(Scrolled(content), 1)
        column.addLayout(foot)
        self._step_page = page
        self._pages.addWidget(page)

    def _shower(self, name: StepName) -> Callable[[], None]:
        return lambda: self.show_step(name)

    def show_step(self, name: StepName) -> None:
        place = [step.name for step in self._steps].index(name)
        self._stack.setCurrentIndex(place)
        if self._step_page is not None:
            self._pages.setCurrentWidget(self._step_page)
            self._place()
        self._step_buttons[name].setChecked(True)
        self._show_checks(self._console.state.preflight.value)
        self._next.setFocus(Qt.FocusReason.TabFocusReason)

    def _on_back(self) -> None:
        place = self._stack.currentIndex()
        if place:
            self.show_step(self._steps[place - 1].name)
        else:
            self._pages.setCurrentIndex(0)
            self._place()
            self._simulated.setFocus(Qt.FocusReason.TabFocusReason)

    def _on_next(self) -> None:
        place = self._stack.currentIndex() + 1
        if place < len(self._steps):
            self.show_step(self._steps[place].name)
        else:
            self._through = True
            self.close_overlay()

    def _show_checks(self, checks: tuple[PreflightCheck, ...]) -> None:
        if self._step_page is None:
            return
        for step in self._steps:
            step_checks = step.of(checks)
            if step_checks:
                self._step_buttons[step.name].show_state(worst(step_checks))
        place = self._stack.currentIndex()
        passed = worst(self._steps[place].of(checks)) == "passed"
        if place == len(self._steps) - 1:
            self._next.set_label(tr("Done"), role="primary")
        else:
            self._next.set_label(tr("Next") if passed else tr("Skip for now"), role="primary" if passed else "plain")


_PAD_PX, _ICON_PX, _CHOICE_PX = 20, 40, 230
_WRAPPED = int(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignTop | Qt.TextFlag.TextWordWrap)


class ChoiceButton(QAbstractButton):
    """Large button with icon, title and explanation."""

    def __init__(self, theme: Theme, title: str, about: str, icon: str, *, primary: bool = False) -> None:
        super().__init__()
        self._theme = theme
        self._about = about
        self._icon = icon
        self._primary = primary
        self._low = False
        self.setText(title)
        self.setAccessibleName(title)
        self.setAccessibleDescription(about)
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setCursor(Qt.CursorShape.PointingHandCursor)
        self.setAttribute(Qt.WidgetAttribute.WA_Hover)
        policy = QSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Minimum)
        policy.setHeightForWidth(True)
        self.setSizePolicy(policy)
        theme.changed.connect(self.update)

    def set_low(self, low: bool) -> None:
        """Switch to a compact layout with the icon on the left."""
        if low != self._low:
            self._low = low
            self.updateGeometry()

    def sizeHint(self) -> QSize:
        least_px = self.minimumSizeHint().height() if self._low else _CHOICE_PX
        return QSize(340, max(least_px, self.heightForWidth(340)))

    def minimumSizeHint(self) -> QSize:
        return QSize(240, 64 if self._low else 120)

    def heightForWidth(self, width: int) -> int:
        return self._rects(width)[1].bottom() + (12 if self._low else _PAD_PX)

    def _rects(self, width: int) -> tuple[QRect, QRect]:
        """Rectangles of title and explanation."""
        left, top = (2 * _PAD_PX + _ICON_PX, 12) if self._low else (_PAD_PX, _PAD_PX + _ICON_PX + 14)
        room = width - left - _PAD_PX
        title = self._metrics(tokens.SPEECH_PX).boundingRect(QRect(left, top, room, 2000), _WRAPPED, self.text())
        below = title.bottom() + 8
        about = self._metrics(tokens.BODY_PX).boundingRect(QRect(left, below, room, 2000), _WRAPPED, self._about)
        return QRect(left, top, room, title.height()), QRect(left, below, room, about.height())

    def _metrics(self, size_px: int) -> QFontMetrics:
        weight = tokens.WEIGHT_SEMIBOLD if size_px == tokens.SPEECH_PX else tokens.WEIGHT_NORMAL
        return QFontMetrics(self._theme.font(size_px, weight))

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter, theme = QPainter(self), self._theme
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        over = self.underMouse() or self.isDown()
        ground = "blue_soft" if self._primary else "raised"
        painter.setBrush(theme.color("raised_hover" if over and not self._primary else ground))
        strong = self.hasFocus() or self._primary or over
        painter.setPen(QPen(theme.color("blue" if strong else "line"), 2.5 if self.hasFocus() else 1.2))
        painter.drawRoundedRect(QRectF(self.rect()).adjusted(1.5, 1.5, -1.5, -1.5), 10, 10)
        place = QRectF(_PAD_PX, _PAD_PX, _ICON_PX, _ICON_PX)
        draw_icon(painter, place, self._icon, theme.color("blue" if self._primary else "dim"))
        title, about = self._rects(self.width())
        painter.setFont(theme.font(tokens.SPEECH_PX, tokens.WEIGHT_SEMIBOLD))
        painter.setPen(theme.color("text"))
        painter.drawText(title, _WRAPPED, self.text())
        painter.setFont(theme.font(tokens.BODY_PX))
        painter.setPen(theme.color("dim"))
        painter.drawText(about, _WRAPPED, self._about)


class StepButton(QAbstractButton):
    """Step with its state as shape and word."""

    def __init__(self, theme: Theme, title: str) -> None:
        super().__init__()
        self._theme = theme
        self._state: PreflightState = "not checked"
        self.setText(title)
        self.setCheckable(True)
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setCursor(Qt.CursorShape.PointingHandCursor)
        self.setAttribute(Qt.WidgetAttribute.WA_Hover)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        theme.changed.connect(self.update)
        self._name()

    def show_state(self, state: PreflightState) -> None:
        if state != self._state:
            self._state = state
            self._name()
            self.update()

    def _name(self) -> None:
        self.setAccessibleName(tr("{step}: {state}").format(step=self.text(), state=tr(STATES[self._state])))

    def sizeHint(self) -> QSize:
        lines = QFontMetrics(self._theme.font()).height() + QFontMetrics(self._theme.font(tokens.STATUS_PX)).height()
        return QSize(180, lines + 18)

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter, theme = QPainter(self), self._theme
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if self.isChecked() or self.underMouse() or self.hasFocus():
            painter.setBrush(theme.color("raised" if self.isChecked() or self.underMouse() else "panel"))
            painter.setPen(QPen(theme.color("blue"), 2) if self.hasFocus() else Qt.PenStyle.NoPen)
            painter.drawRoundedRect(QRectF(self.rect()).adjusted(1, 1, -1, -1), 8, 8)
        middle = self.height() / 2
        draw_icon(painter, QRectF(12, middle - 11, 22, 22), ICONS[self._state], theme.color(ROLES[self._state]))
        painter.setFont(theme.font(tokens.BODY_PX, tokens.WEIGHT_SEMIBOLD if self.isChecked() else 400))
        painter.setPen(theme.color("text"))
        room = self.width() - 52
        upper = QRectF(44, 0, room, middle + 1)
        text = painter.fontMetrics().elidedText(self.text(), Qt.TextElideMode.ElideRight, room)
        painter.drawText(upper, int(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignBottom), text)
        painter.setFont(theme.font(tokens.STATUS_PX))
        painter.setPen(theme.color(ROLES[self._state]))
        lower = QRectF(44, middle + 1, room, middle - 1)
        painter.drawText(lower, int(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignTop), tr(STATES[self._state]))
