"""Robot discovery dialog: find topics, map them, check their streams, save a profile."""

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol
from urllib.parse import urlsplit

from PySide6.QtCore import QRectF, QSize, Qt, Signal
from PySide6.QtGui import QAccessible, QCloseEvent, QPainter, QPaintEvent, QResizeEvent
from PySide6.QtWidgets import (
    QButtonGroup,
    QDialog,
    QGridLayout,
    QLabel,
    QLineEdit,
    QListWidget,
    QScrollArea,
    QSizePolicy,
    QStackedWidget,
    QWidget,
)

from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.wizard_console import RobotChoice
from caris_desktop.robot.profile import (
    ProfileError,
    RobotProfile,
    SecuritySettings,
    check_address,
    profile_file_name,
    user_robots_dir,
)
from caris_desktop.robot.profile_proposal import FieldProposal, Proposal, RobotOffer, profile_of, propose
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.tab_order import VisualTabOrderMixin
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.drop_down import DropDown
from caris_desktop.ui.widgets.elided_label import ElidedLabel
from caris_desktop.ui.widgets.scroll_areas import Scrolled

if TYPE_CHECKING:  # importing its sockets takes 0.25 s and would delay the first window
    from caris_desktop.robot.discovery import Exploration, StreamCheck

logger = logging.getLogger(__name__)
_LEAST_PAGE_PX = 200
_USUAL_PORT = 9090


class RobotExplorer(Protocol):
    """Robot discovery outside the GUI thread. Call from the GUI thread; every call returns at once.

    Callbacks follow in the GUI thread. ``cancel`` aborts the current operation without callback.
    """

    def explore(
        self,
        address: str,
        *,
        security: SecuritySettings,
        progress: Callable[[str], None],
        done: "Callable[[Exploration | UserFacingError], None]",
    ) -> None:
        """Query topics, services and actions of the robot at ``address``. ``progress`` gets a short text per step."""

    def check(
        self,
        profile: RobotProfile,
        *,
        progress: "Callable[[StreamCheck], None]",
        done: "Callable[[tuple[StreamCheck, ...] | UserFacingError], None]",
    ) -> None:
        """Check all streams of the profile; ``progress`` gets each result as it arrives."""

    def save(self, profile: RobotProfile, title: str, *, done: Callable[[RobotChoice | UserFacingError], None]) -> None:
        """Save the profile as one of the user's under ``title``; an existing one is never overwritten."""

    def read(self, name: str, *, done: Callable[[RobotProfile | UserFacingError], None]) -> None:
        """Load the profile of that name."""

    def cancel(self) -> None: ...


def offer_lines(offer: RobotOffer) -> list[str]:
    """Everything the robot offers, one per line: kind, name, type."""
    return [
        f"{kind}   {name}   {found_type}".rstrip()
        for kind, names in (("topic", offer.topics), ("service", offer.services), ("action", offer.actions))
        for name, found_type in sorted(names.items())
    ]


def with_usual_port(address: str) -> str:
    """The address with rosbridge's default port, if it has none."""
    try:
        parts = urlsplit(address)
        alone = bool(parts.hostname) and parts.port is None and not parts.netloc.endswith(":")
    except ValueError:  # the address check reports the error
        return address
    return parts._replace(netloc=f"{parts.netloc}:{_USUAL_PORT}").geturl() if alone else address


class RobotDialog(VisualTabOrderMixin, QDialog):
    """Non-modal: the connected robot can be driven and stopped meanwhile. Ends with ``saved(RobotChoice)``."""

    saved = Signal(object)

    def __init__(self, theme: Theme, explorer: RobotExplorer, parent: QWidget, *, address: str = "") -> None:
        super().__init__(parent)
        self.setObjectName("robot_dialog")
        self.setWindowTitle(tr("Connect another robot"))
        self._theme = theme
        self._explorer = explorer
        self._found: Exploration | None = None
        self._proposal: Proposal | None = None
        self._busy = ""
        self._rows: dict[str, MappingRow] = {}
        self._heading = QLabel(tr("Which robot?"))
        self._hint = QLabel(
            tr(
                "Enter the address of rosbridge on the robot. Scanning only reads: nothing is sent that could "
                "move the robot."
            )
        )
        self._hint.setWordWrap(True)
        self.address_field = QLineEdit(address, placeholderText=tr("ws://192.168.1.20:9090 or wss://…"))
        self.address_field.setObjectName("robot_address")
        self.address_field.setAccessibleName(tr("Address of the robot"))
        self.address_field.setMinimumHeight(36)
        self.address_field.setMaxLength(300)
        self.address_field.returnPressed.connect(self.query_robot)
        self.address_field.textChanged.connect(self._on_address_changed)
        self._scan_button = ActionButton(
            theme, tr("Scan"), icon="magnifying-glass", key="Enter", role="primary", height_px=36
        )
        self._scan_button.setObjectName("robot_look")
        self._scan_button.clicked.connect(self.query_robot)
        self._certificates = self._optional_field(
            "robot_certificates", tr("a PEM file, if not signed by a known authority")
        )
        self._fingerprint = self._optional_field(
            "robot_fingerprint", tr("64 hexadecimal digits, read on the robot itself")
        )
        self._secret = self._optional_field("robot_secret", tr("for example MY_ROBOT_SECRET"))
        self._security = QWidget()
        security = QGridLayout(self._security)
        security.setContentsMargins(0, 0, 0, 0)
        for line, (text, field) in enumerate(
            (
                (tr("Certificate file"), self._certificates),
                (tr("Certificate fingerprint (SHA-256)"), self._fingerprint),
                (tr("Environment variable with the secret"), self._secret),
            )
        ):
            field.setAccessibleName(text)
            security.addWidget(QLabel(text), 2 * line, 0)
            security.addWidget(field, 2 * line + 1, 0)
        self._security.hide()
        self._security_toggle = ActionButton(theme, tr("Security"), icon="lock-simple", role="ghost", height_px=36)
        self._security_toggle.setObjectName("robot_security")
        self._security_toggle.setCheckable(True)
        self._security_toggle.setToolTip(tr("Custom certificates (wss://) and the rosauth secret"))
        self._security_toggle.toggled.connect(self._security.setVisible)
        self._note = NoteLine(theme)
        self._note.setObjectName("robot_note")
        self._pages = QStackedWidget()
        self._pages.addWidget(self._make_mapping_page())
        self._pages.addWidget(self._make_offer_page())
        self._pages.hide()
        self._empty = QLabel(
            tr(
                "Enter the address and scan. You then see what the robot offers, choose the mapping and "
                "check the live data."
            )
        )
        self._empty.setWordWrap(True)
        self._empty.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self._tabs = self._make_tabs()
        self.name_field = QLineEdit(placeholderText=tr("for example Lab robot"), maxLength=60)
        self.name_field.setObjectName("robot_name")
        self.name_field.setAccessibleName(tr("Name of the robot"))
        self.name_field.setMinimumHeight(36)
        self.name_field.textChanged.connect(self._refresh)
        self._file = ElidedLabel()
        self._file.setObjectName("robot_file")
        self._check = ActionButton(theme, tr("Check live"), icon="activity", height_px=38)
        self._check.setObjectName("robot_check")
        self._check.setToolTip(tr("Listen to every stream for a few seconds"))
        self._check.clicked.connect(self.check)
        self._save = ActionButton(theme, tr("Save and connect"), role="primary", height_px=38)
        self._save.setObjectName("robot_save")
        self._save.clicked.connect(self.save)
        cancel = ActionButton(theme, tr("Cancel"), role="ghost", height_px=38)
        cancel.setObjectName("robot_cancel")
        cancel.clicked.connect(self.reject)
        self._lay_out(cancel)
        theme.restyle_on_change(self._style)
        self._refresh()
        self.resize(QSize(920, 720).boundedTo(self.screen().availableSize() - QSize(40, 60)))
        self.address_field.setFocus(Qt.FocusReason.OtherFocusReason)
        self.address_field.selectAll()

    def _optional_field(self, name: str, placeholder: str) -> QLineEdit:
        field = QLineEdit(placeholderText=placeholder, maxLength=500)
        field.setObjectName(name)
        return field

    def _make_tabs(self) -> QWidget:
        holder = QWidget()
        self._summary = ElidedLabel()
        self._summary.setObjectName("robot_summary")
        row = layouts.hbox(holder, margins_px=0, spacing_px=6)
        group = QButtonGroup(holder)
        for page, text in enumerate((tr("Mapping"), tr("Everything found"))):
            button = ActionButton(self._theme, text, role="ghost")
            button.setObjectName(f"robot_page_{page}")
            button.setCheckable(True)
            button.setChecked(page == 0)
            group.addButton(button, page)
            row.addWidget(button)
        group.idClicked.connect(self._pages.setCurrentIndex)
        row.addSpacing(12)
        row.addWidget(self._summary, 1)
        holder.hide()
        return holder

    def _make_mapping_page(self) -> QWidget:
        page = QWidget()
        self._start_label, self._namespace_label = QLabel(tr("Start from")), QLabel(tr("Namespace"))
        self.start_from = DropDown(self._theme, "robot_start_from", tr("Start from"))
        self.start_from.setMinimumWidth(340)
        self.start_from.activated.connect(self._on_start_chosen)
        self.namespace = DropDown(self._theme, "robot_namespace", tr("Which robot on this server"))
        self.namespace.setMinimumWidth(180)
        self.namespace.activated.connect(self._on_namespace_chosen)
        choices = layouts.hbox(spacing_px=8)
        for widget in (self._start_label, self.start_from, self._namespace_label, self.namespace):
            choices.addWidget(widget)
        choices.addStretch(1)
        self._grid_holder = QWidget()
        self._column = layouts.vbox(self._grid_holder, margins_px=(0, 0, 8, 0), spacing_px=4)
        self._column.addStretch(1)
        scroll = QScrollArea(widgetResizable=True)
        scroll.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        scroll.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        scroll.setWidget(self._grid_holder)
        column = layouts.vbox(page, margins_px=0, spacing_px=8)
        column.addLayout(choices)
        column.addWidget(scroll, 1)
        return page

    def _make_offer_page(self) -> QWidget:
        page = QWidget()
        self._filter = QLineEdit(placeholderText=tr("Filter by name or type…"))
        self._filter.setObjectName("robot_filter")
        self._filter.setAccessibleName(tr("Filter"))
        self._filter.textChanged.connect(self._fill_offer)
        self.offer_list = QListWidget()
        self.offer_list.setObjectName("robot_offer")
        self.offer_list.setAccessibleName(tr("Everything the robot offers"))
        column = layouts.vbox(page, margins_px=0)
        column.addWidget(self._filter)
        column.addWidget(self.offer_list, 1)
        return page

    def _lay_out(self, cancel: ActionButton) -> None:
        address = layouts.hbox(spacing_px=8)
        address.addWidget(self.address_field, 1)
        address.addWidget(self._scan_button)
        address.addWidget(self._security_toggle)
        foot = layouts.hbox(spacing_px=8)
        foot.addWidget(cancel)
        foot.addStretch(1)
        foot.addWidget(self._check)
        foot.addWidget(self._save)
        named = layouts.hbox(spacing_px=8)
        named.addWidget(QLabel(tr("Name")))
        named.addWidget(self.name_field, 1)
        self._pages.setMinimumHeight(_LEAST_PAGE_PX)
        self._pages.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Ignored)
        content = QWidget()
        layout = layouts.vbox(content, margins_px=0, spacing_px=10)
        layout.addWidget(self._heading)
        layout.addWidget(self._hint)
        layout.addLayout(address)
        layout.addWidget(self._security)
        layout.addWidget(self._note)
        layout.addWidget(self._tabs)
        layout.addWidget(self._pages, 1)
        layout.addWidget(self._empty, 1)
        layout.addLayout(named)
        layout.addWidget(self._file)
        outer = layouts.vbox(self, margins_px=(24, 20, 24, 20), spacing_px=12)
        outer.addWidget(Scrolled(content), 1)
        outer.addLayout(foot)

    # ---- commands

    def query_robot(self) -> None:
        """Query the robot at the address."""
        if self._busy:
            return
        address = self.address_field.text().strip()
        if address and "://" not in address:
            address = with_usual_port(f"ws://{address}")
            self.address_field.setText(address)
        try:
            check_address(address)
        except ProfileError as error:
            self._note.show_note("amber", "warning", str(error))
            return
        self._forget()
        self._set_busy(tr("Scanning"))
        self._explorer.explore(
            address, security=self._security_settings(), progress=self._on_progress, done=self._on_explored
        )

    def check(self) -> None:
        """Check all streams of the mapping."""
        self._with_profile(self._check_it)

    def _check_it(self, profile: RobotProfile) -> None:
        for row in self._rows.values():
            row.show_check(None)
        self._drop_extra_rows()
        self._set_busy(tr("Listening to every stream for a few seconds"))
        self._explorer.check(profile, progress=self._on_checked, done=self._on_check_done)

    def save(self) -> None:
        if self._title():
            self._with_profile(self._save_it)

    def _save_it(self, profile: RobotProfile) -> None:
        self._set_busy(tr("Saving"))
        self._explorer.save(profile, self._title(), done=self._on_saved)

    def row(self, field: str) -> "MappingRow | None":
        return self._rows.get(field)

    @property
    def note_text(self) -> str:
        return self._note.text

    def _title(self) -> str:
        return " ".join(self.name_field.text().split())

    def _security_settings(self) -> SecuritySettings:
        return SecuritySettings(
            ca_file=self._certificates.text().strip() or None,
            certificate_sha256=self._fingerprint.text().strip() or None,
            rosauth_secret_env=self._secret.text().strip() or None,
        )

    def _with_profile(self, use: Callable[[RobotProfile], None]) -> None:
        """Call ``use`` with the profile as edited now, after a successful query; another robot's profile is loaded
        first.
        """
        if self._busy or self._found is None:
            return
        title, address, security = self._title() or tr("Robot"), self._found.address, self._security_settings()
        known = self.start_from.currentData()
        if not known:
            chosen = {field: row.value for field, row in self._rows.items() if row.proposal is not None}
            use(profile_of(self._found.offer, chosen, name="new", title=title, address=address, security=security))
            return

        def read(profile: RobotProfile | UserFacingError) -> None:
            self._set_busy("")
            if isinstance(profile, UserFacingError):
                self._show_failure(profile)
            else:
                use(replace(profile, title=title, address=address, security=security))

        self._set_busy(tr("Reading the robot profile"))
        self._explorer.read(known, done=read)

    # ---- explorer callbacks

    def _on_progress(self, step: str) -> None:
        self._note.show_note("blue", "hourglass", f"{tr(step)}…")

    def _on_explored(self, found: "Exploration | UserFacingError") -> None:
        self._set_busy("")
        if isinstance(found, UserFacingError):
            self._show_failure(found)
            if "certificate" in str(found).casefold() or "secret" in str(found).casefold():
                self._security_toggle.setChecked(True)
            return
        self._found = found
        self._proposal = found.proposal
        offer = found.offer
        ros = f"ROS {offer.dialect.value} {offer.distribution}".strip() if offer.dialect else tr("unknown ROS version")
        self._summary.setText(
            " · ".join(
                (
                    ros,
                    tr("1 topic") if len(offer.topics) == 1 else tr("%n topics", "", len(offer.topics)),
                    tr("1 service") if len(offer.services) == 1 else tr("%n services", "", len(offer.services)),
                    tr("1 action") if len(offer.actions) == 1 else tr("%n actions", "", len(offer.actions)),
                )
            )
        )
        self.start_from.clear()
        self.start_from.addItem(tr("Detected mapping"), "")
        for like in found.resembles:
            resembles = tr("Profile of {robot} ({share:.0%} of its names found)")
            self.start_from.addItem(resembles.format(robot=like.title, share=like.share), like.name)
        has_likes = bool(found.resembles)
        self._start_label.setVisible(has_likes)
        self.start_from.setVisible(has_likes)
        self.namespace.clear()
        for namespace in found.proposal.namespaces:
            self.namespace.addItem(namespace or tr("no namespace"), namespace)
        self.namespace.setCurrentIndex(max(0, self.namespace.findData(found.proposal.namespace)))
        several = len(found.proposal.namespaces) > 1
        self._namespace_label.setVisible(several)
        self.namespace.setVisible(several)
        self._fill_offer()
        self._show_proposal(found.proposal)
        self._note.show_note("green", "check-circle", tr("The robot responds. Review the mapping, then check it live."))
        notes = " ".join(map(tr, found.proposal.notes))
        if notes:
            self._note.show_note("amber", "info", notes)
        self.name_field.setFocus(Qt.FocusReason.OtherFocusReason)
        self._refresh()

    def _on_checked(self, check: "StreamCheck") -> None:
        row = self._rows.get(check.field)
        if row is None:
            row = self._rows[check.field] = MappingRow(self._theme, check.field, check.label, None, topic=check.topic)
            self._column.insertWidget(self._column.count() - 1, row)
        row.show_check(check)

    def _on_check_done(self, checks: "tuple[StreamCheck, ...] | UserFacingError") -> None:
        self._set_busy("")
        if isinstance(checks, UserFacingError):
            self._show_failure(checks)
            return
        bad = [tr(check.label) for check in checks if check.state in ("nothing", "wrong")]
        slow = [tr(check.label) for check in checks if check.state == "slow"]
        if bad:
            wrong = tr("Not working yet: {streams}. Choose another topic or leave it out.")
            self._note.show_note("amber", "warning", wrong.format(streams=", ".join(dict.fromkeys(bad))))
        elif slow:
            rare = tr("Update rate too low for safe driving: {streams}.")
            self._note.show_note("amber", "warning", rare.format(streams=", ".join(slow)))
        else:
            self._note.show_note("green", "check-circle", tr("All streams are working."))

    def _on_saved(self, choice: RobotChoice | UserFacingError) -> None:
        self._set_busy("")
        if isinstance(choice, UserFacingError):
            self._show_failure(choice)
            return
        self.accept()
        self.saved.emit(choice)

    def _show_failure(self, failure: UserFacingError) -> None:
        text = " ".join(map(tr, (failure.what, failure.meaning, failure.advice)))
        self._note.show_note("red", "warning-octagon", text)

    # ---- display

    def _on_address_changed(self, _text: str) -> None:
        if self._busy:
            self._explorer.cancel()
            self._set_busy("")
        self._forget()
        self._note.show_note("dim", "", "")

    def _on_start_chosen(self, _index: int) -> None:
        if self._proposal is not None:
            self._show_proposal(self._proposal)

    def _on_namespace_chosen(self, _index: int) -> None:
        if self._found is not None:
            self._proposal = propose(self._found.offer, namespace=self.namespace.currentData())
            self._show_proposal(self._proposal)

    def _forget(self) -> None:
        self._found = None
        self._proposal = None
        self._clear_rows()
        self._refresh()

    def _clear_rows(self) -> None:
        for row in self._rows.values():
            self._column.removeWidget(row)
            row.hide()
            row.deleteLater()
        self._rows = {}

    def _drop_extra_rows(self) -> None:
        for field in [field for field, row in self._rows.items() if row.proposal is None]:
            row = self._rows.pop(field)
            self._column.removeWidget(row)
            row.hide()
            row.deleteLater()

    def _show_proposal(self, proposal: Proposal) -> None:
        self._clear_rows()
        if not self.start_from.currentData():
            # Fields without candidates come last.
            ordered = sorted(proposal.fields, key=lambda field: not field.candidates)
            for field in ordered:
                row = self._rows[field.field] = MappingRow(self._theme, field.field, field.label, field)
                self._column.insertWidget(self._column.count() - 1, row)
        self._refresh()

    def _fill_offer(self) -> None:
        self.offer_list.clear()
        if self._found is not None:
            query_words = self._filter.text().casefold().split()
            self.offer_list.addItems(
                [
                    line
                    for line in offer_lines(self._found.offer)
                    if all(word in line.casefold() for word in query_words)
                ]
            )

    def _set_busy(self, activity: str) -> None:
        self._busy = activity
        if activity:
            self._note.show_note("blue", "hourglass", f"{activity}…")
        self._refresh()

    def _refresh(self) -> None:
        found = self._found is not None
        self._tabs.setVisible(found)
        self._pages.setVisible(found)
        self._empty.setVisible(not found)
        named = found and bool(self._title())
        self._file.setVisible(named)
        if named:
            file = user_robots_dir() / profile_file_name(self._title())
            self._file.setText(tr("The profile will be saved as {file}.").format(file=file))
        self._scan_button.setEnabled(not self._busy)
        self._scan_button.set_label(tr("Scan again") if found else tr("Scan"))
        self._check.setEnabled(found and not self._busy)
        self._save.setEnabled(found and not self._busy and bool(self._title()))
        self._save.setToolTip("" if self._title() else tr("Give the robot a name first"))

    def _style(self) -> None:
        self._heading.setFont(self._theme.font(tokens.SPEECH_PX, tokens.WEIGHT_SEMIBOLD))
        for label in (self._hint, self._empty, self._summary, self._start_label, self._namespace_label, self._file):
            self._theme.style_text(label, "dim", tokens.STATUS_PX)

    def done(self, result: int) -> None:
        self._explorer.cancel()
        super().done(result)

    def closeEvent(self, event: QCloseEvent) -> None:
        self._explorer.cancel()
        super().closeEvent(event)


NOT_USED = QT_TR_NOOP("– not used –")
_CHECK_LOOKS = {
    "good": ("check-circle", "green", QT_TR_NOOP("active")),
    "slow": ("warning", "amber", QT_TR_NOOP("update rate too low")),
    "quiet": ("minus-circle", "dim", QT_TR_NOOP("no data now, which is normal")),
    "nothing": ("x-circle", "red", QT_TR_NOOP("no data")),
    "wrong": ("x-circle", "red", QT_TR_NOOP("does not match")),
}
_SHORT_LIST = 12


def rate_words(check: "StreamCheck") -> str:
    """Text of a stream check, such as "comes, 10.0 Hz, 0.1 s old · 720 beams over 360 degrees"."""
    if check.detail and check.age_s is None:
        return tr(check.detail)  # nothing was counted: the sentence is complete
    parts = [tr(_CHECK_LOOKS[check.state][2])]
    if check.rate_hz is not None:
        parts.append(f"{check.rate_hz:.1f} Hz")
    if check.age_s is not None:
        parts.append(tr("{age} old").format(age=text_formatting.age(check.age_s)))
    line = ", ".join(parts)
    return f"{line} · {tr(check.detail)}" if check.detail else line


class NoteLine(QWidget):
    """Message with its icon; height follows the text."""

    accessible_role = QAccessible.Role.StaticText

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self._theme = theme
        self._role, self._icon = "dim", ""
        self._label = QLabel(wordWrap=True)
        self._label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        row = layouts.hbox(self, margins_px=(28, 2, 0, 2))
        row.addWidget(self._label)
        theme.changed.connect(self._style)
        self.hide()

    @property
    def text(self) -> str:
        return self._label.text()

    def show_note(self, role: str, icon: str, text: str) -> None:
        self._role, self._icon = role, icon
        self._label.setText(" ".join(text.split()))
        self.setAccessibleName(text)
        self.setVisible(bool(text))
        self._style()

    def _style(self) -> None:
        self._theme.color_text(self._label, "text")
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        if self._icon:
            painter = QPainter(self)
            painter.setRenderHint(QPainter.RenderHint.Antialiasing)
            draw_icon(painter, _icon_rect(4), self._icon, self._theme.color(self._role))


class MappingRow(QWidget):
    """Mapping of one function to a ROS name, with the stream check."""

    def __init__(
        self, theme: Theme, field: str, label: str, proposal: FieldProposal | None, *, topic: str = ""
    ) -> None:
        super().__init__()
        self.setObjectName(f"mapping_{field}")
        self._theme = theme
        self.proposal = proposal
        self._check: StreamCheck | None = None
        self._words = ""
        label = tr(label)
        name = QLabel(label, wordWrap=True)
        name.setFixedWidth(170)
        self._verdict = QLabel()
        self._verdict.setObjectName("mapping_verdict")
        self._verdict.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)
        self.box = DropDown(theme, f"mapping_{field}_box", label)
        self.box.setFixedWidth(270)
        self.box.setMaxVisibleItems(_SHORT_LIST)
        row = layouts.hbox(self, margins_px=(0, 1, 0, 1), spacing_px=8)
        row.addWidget(name)
        if proposal is None:
            fixed = QLabel(topic)
            fixed.setFixedWidth(270)
            fixed.setToolTip(topic)
            row.addWidget(fixed)
            self.box.hide()
            self.box.setParent(self)
        else:
            self.box.addItem(tr(NOT_USED), "")
            for candidate in proposal.candidates:
                self.box.addItem(candidate.value, candidate.value)
                self.box.setItemData(
                    self.box.count() - 1, f"{candidate.type}\n{tr(candidate.why)}".strip(), Qt.ItemDataRole.ToolTipRole
                )
            self.box.setCurrentIndex(max(0, self.box.findData(proposal.value)))
            self.box.setEnabled(bool(proposal.candidates))
            self.box.activated.connect(self._on_chosen)
            row.addWidget(self.box)
        row.addSpacing(24)
        row.addWidget(self._verdict, 1)
        theme.restyle_on_change(self._show)

    @property
    def value(self) -> str:
        """Selected ROS name; empty for none."""
        return str(self.box.currentData() or "")

    @property
    def verdict_text(self) -> str:
        return self._words

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._elide()

    def _elide(self) -> None:
        room = self._verdict.width()
        self._verdict.setText(self._verdict.fontMetrics().elidedText(self._words, Qt.TextElideMode.ElideRight, room))

    def show_check(self, check: "StreamCheck | None") -> None:
        self._check = check
        self._show()

    def _on_chosen(self, _index: int) -> None:
        self._check = None
        self._show()

    def _show(self) -> None:
        self._verdict.setFont(self._theme.font(tokens.STATUS_PX))
        if self._check is not None:
            text = rate_words(self._check)
        elif self.proposal is None:
            text = ""
        elif not self.proposal.candidates:
            text = tr("the robot offers nothing suitable")
        else:
            chosen = next((each for each in self.proposal.candidates if each.value == self.value), None)
            text = (
                tr(chosen.why)
                if chosen is not None
                else tr("left out")
                if self.proposal.value
                else tr(self.proposal.why)
            )
        self._words = text
        self._elide()
        self._verdict.setToolTip(text)
        self._theme.color_text(self._verdict, "text" if self._check is not None else "dim")
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        if self._check is not None:
            icon, role, _ = _CHECK_LOOKS[self._check.state]
            painter = QPainter(self)
            painter.setRenderHint(QPainter.RenderHint.Antialiasing)
            rect = _icon_rect((self.height() - 18) / 2)
            rect.moveLeft(self._verdict.x() - 26)
            draw_icon(painter, rect, icon, self._theme.color(role))


def _icon_rect(top: float) -> QRectF:
    return QRectF(2, top, 18, 18)
