"""Robot discovery dialog: find topics, map them, check their streams, save a profile."""

import logging
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from PySide6.QtCore import QSize, Qt, Signal
from PySide6.QtGui import QAccessible, QCloseEvent
from PySide6.QtWidgets import QLabel, QLineEdit, QListWidget, QSizePolicy, QTabWidget, QWidget

from caris_desktop.domain.address import plugin_address
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.plugins import BUILT_IN
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.robot.profile import ListedProfile, own_profile_file
from caris_desktop.robot.profile_model import ProfileError, RobotProfile, SecuritySettings, check_address
from caris_desktop.robot.profile_proposal import FieldProposal, Proposal, RobotOffer, profile_of, propose
from caris_desktop.ui import layouts, text_formatting
from caris_desktop.ui.form_dialog import FormDialog, lay_out_form, resize_to
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import list_area
from caris_desktop.ui.widgets.inputs import DropDown
from caris_desktop.ui.widgets.labels import ElidedLabel, IconLabel, label, line_edit, named, restyle

if TYPE_CHECKING:  # importing its sockets takes 0.25 s and would delay the first window
    from caris_desktop.live.robot_explorer import LiveRobotExplorer
    from caris_desktop.robot.discovery import Exploration, StreamCheck

logger = logging.getLogger(__name__)
_LEAST_PAGE_PX = 200
_USUAL_PORT = 9090


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


def names_plugin(address: str) -> bool:
    """Whether it is the address of a robot plug-in, such as ``ros2:5``, rather than a host with its port."""
    name, target = plugin_address(address) or ("", "")
    return name in BUILT_IN["robots"] or bool(name and not target.isdecimal())


class RobotDialog(FormDialog):
    """The connected robot can be driven and stopped meanwhile. Ends with ``saved(ListedProfile)``."""

    saved = Signal(object)

    def __init__(self, theme: Theme, explorer: "LiveRobotExplorer", parent: QWidget, *, address: str = "") -> None:
        super().__init__(theme, parent, "robot_dialog", tr("Connect another robot"))
        self._explorer = explorer
        self._found: Exploration | None = None
        self._busy = ""
        self._rows: dict[str, MappingRow] = {}
        hint = tr(
            "Enter the address of rosbridge on the robot. Scanning only reads: nothing is sent that could move the "
            "robot."
        )
        self.address_field = line_edit(
            "robot_address", tr("Address of the robot"), address, maxLength=300, returnPressed=self.query_robot,
            placeholderText=tr("ws://192.168.1.20:9090 or wss://…"), textChanged=self._on_address_changed,
        )  # fmt: skip
        self._scan_button = self.button(
            "robot_look", tr("Scan"), self.query_robot, icon="magnifying-glass", key="Enter", role="primary",
            height_px=36,
        )  # fmt: skip
        self._security = QWidget()
        security = layouts.vbox(self._security, margins_px=0)
        self._certificates, self._fingerprint, self._secret = (
            QLineEdit(placeholderText=placeholder, maxLength=500)
            for placeholder in (
                tr("a PEM file, if not signed by a known authority"),
                tr("64 hexadecimal digits, read on the robot itself"),
                tr("for example MY_ROBOT_SECRET"),
            )
        )
        for field, name, text in (
            (self._certificates, "certificates", tr("Certificate file")),
            (self._fingerprint, "fingerprint", tr("Certificate fingerprint (SHA-256)")),
            (self._secret, "secret", tr("Environment variable with the secret")),
        ):
            field.setObjectName(f"robot_{name}")
            field.setAccessibleName(text)
            layouts.fill(security, QLabel(text), field)
        self._security.hide()
        self._security_toggle = ActionButton(
            theme, tr("Security"), objectName="robot_security", icon="lock-simple", role="ghost", height_px=36,
            checkable=True, toggled=self._security.setVisible,
            toolTip=tr("Custom certificates (wss://) and the rosauth secret"),
        )  # fmt: skip
        self._note = NoteLine(theme)
        self._summary = ElidedLabel(role="note", objectName="robot_summary")
        self._pages = QTabWidget(documentMode=True)
        self._pages.setObjectName("robot_pages")
        self._pages.setFocusProxy(None)  # type: ignore[arg-type] # Qt takes none
        self._pages.setFocusPolicy(Qt.FocusPolicy.NoFocus)  # its tab bar has the keys, and the name of each page
        self._pages.addTab(self._make_mapping_page(), tr("Mapping"))
        self._pages.addTab(self._make_offer_page(), tr("Everything found"))
        self._pages.setMinimumHeight(_LEAST_PAGE_PX)
        self._pages.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Ignored)
        self._empty = label(
            tr(
                "Enter the address and scan. You then see what the robot offers, choose the mapping and check the live "
                "data."
            ),
            "note", wraps=True, alignment=Qt.AlignmentFlag.AlignCenter,
        )  # fmt: skip
        self.name_field = line_edit(
            "robot_name", tr("Name of the robot"), placeholderText=tr("for example Lab robot"), maxLength=60,
            textChanged=self._refresh,
        )  # fmt: skip
        self._file = ElidedLabel(role="note", objectName="robot_file")
        self._check = self.button(
            "robot_check", tr("Check live"), self.check, icon="activity",
            toolTip=tr("Listen to every stream for a few seconds"),
        )  # fmt: skip
        self._save = self.button("robot_save", tr("Save and connect"), self.save, role="primary")
        cancel = self.button("robot_cancel", tr("Cancel"), self.reject, role="ghost")
        lay_out_form(
            self,
            label(tr("Which robot?"), "heading"),
            label(hint, "note", wraps=True),
            layouts.hbox(None, (self.address_field, 1), self._scan_button, self._security_toggle, spacing_px=8),
            self._security,
            self._note,
            self._summary,
            (self._pages, 1),
            (self._empty, 1),
            layouts.hbox(None, QLabel(tr("Name")), (self.name_field, 1), spacing_px=8),
            self._file,
            buttons=(cancel, 1, self._check, self._save),
            spacing_px=10,
        )
        self._refresh()
        resize_to(self, QSize(920, 720))
        self.address_field.setFocus(Qt.FocusReason.OtherFocusReason)
        self.address_field.selectAll()

    def _make_mapping_page(self) -> QWidget:
        page = QWidget()
        self._start_label, self._namespace_label = label(tr("Start from"), "note"), label(tr("Namespace"), "note")
        self.start_from = DropDown(self._theme, "robot_start_from", tr("Start from"), minimumWidth=340)
        self.start_from.activated.connect(self._propose)
        self.namespace = DropDown(self._theme, "robot_namespace", tr("Which robot on this server"), minimumWidth=180)
        self.namespace.activated.connect(self._propose)
        choices = layouts.hbox(
            None, self._start_label, self.start_from, self._namespace_label, self.namespace, 1, spacing_px=8
        )
        rows = QWidget()
        self._column = layouts.vbox(rows, 1, margins_px=(0, 0, 8, 0), spacing_px=4)
        layouts.vbox(page, choices, (list_area(rows), 1), margins_px=(0, 8, 0, 0), spacing_px=8)
        return page

    def _make_offer_page(self) -> QWidget:
        page = QWidget()
        hint = tr("Filter by name or type…")
        self._filter = line_edit("robot_filter", tr("Filter"), placeholderText=hint, textChanged=self._fill_offer)
        self.offer_list = named(QListWidget(), "robot_offer", tr("Everything the robot offers"))
        layouts.vbox(page, self._filter, (self.offer_list, 1), margins_px=(0, 8, 0, 0))
        return page

    # ---- commands

    def query_robot(self) -> None:
        """Query the robot at the address."""
        if self._busy:
            return
        address = self.address_field.text().strip()
        if address and "://" not in address and not names_plugin(address):
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
        self._drop_rows([field for field, row in self._rows.items() if row.proposal is None])
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
        resembles = tr("Profile of {robot} ({share:.0%} of its names found)")
        likes = [(resembles.format(robot=like.title, share=like.share), like.name) for like in found.resembles]
        self.start_from.fill([(tr("Detected mapping"), ""), *likes], "")
        namespaces = [(name or tr("no namespace"), name) for name in found.proposal.namespaces]
        self.namespace.fill(namespaces, found.proposal.namespace)
        for part in (self._start_label, self.start_from):
            part.setVisible(bool(likes))
        for part in (self._namespace_label, self.namespace):
            part.setVisible(len(namespaces) > 1)
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

    def _on_saved(self, choice: ListedProfile | UserFacingError) -> None:
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

    def _propose(self) -> None:
        if self._found is not None:
            self._show_proposal(propose(self._found.offer, namespace=self.namespace.currentData()))

    def _forget(self) -> None:
        self._found = None
        self._drop_rows(self._rows)
        self._refresh()

    def _drop_rows(self, fields: Iterable[str]) -> None:
        for field in list(fields):
            row = self._rows.pop(field)
            self._column.removeWidget(row)
            layouts.discard(row)

    def _show_proposal(self, proposal: Proposal) -> None:
        self._drop_rows(self._rows)
        if not self.start_from.currentData():
            # Fields without candidates come last.
            for field in sorted(proposal.fields, key=lambda field: not field.candidates):
                row = self._rows[field.field] = MappingRow(self._theme, field.field, field.label, field)
                self._column.insertWidget(self._column.count() - 1, row)
        self._refresh()

    def _fill_offer(self) -> None:
        self.offer_list.clear()
        if self._found is not None:
            words = self._filter.text().casefold().split()
            lines = offer_lines(self._found.offer)
            self.offer_list.addItems([line for line in lines if all(word in line.casefold() for word in words)])

    def _set_busy(self, activity: str) -> None:
        self._busy = activity
        if activity:
            self._note.show_note("blue", "hourglass", f"{activity}…")
        self._refresh()

    def _refresh(self) -> None:
        found = self._found is not None
        self._summary.setVisible(found)
        self._pages.setVisible(found)
        self._empty.setVisible(not found)
        named = found and bool(self._title())
        self._file.setVisible(named)
        if named:
            file = own_profile_file(self._title())
            self._file.setText(tr("The profile will be saved as {file}.").format(file=file))
        self._scan_button.setEnabled(not self._busy)
        self._scan_button.set_label(tr("Scan again") if found else tr("Scan"))
        self._check.setEnabled(found and not self._busy)
        self._save.setEnabled(found and not self._busy and bool(self._title()))
        self._save.setToolTip("" if self._title() else tr("Give the robot a name first"))

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
        self.setObjectName("robot_note")
        self._icon = IconLabel(theme)
        self._label = label(wraps=True, textInteractionFlags=Qt.TextInteractionFlag.TextSelectableByMouse)
        parts = (self._icon, 0, layouts.TOP), (self._label, 1)
        layouts.hbox(self, *parts, margins_px=(2, 2, 0, 2), spacing_px=8)
        self.hide()

    @property
    def text(self) -> str:
        return self._label.text()

    def show_note(self, role: str, icon: str, text: str) -> None:
        self._icon.show_icon(icon, role)
        self._label.setText(" ".join(text.split()))
        self.setAccessibleName(text)
        self.setVisible(bool(text))


class MappingRow(QWidget):
    """Mapping of one function to a ROS name, with the stream check."""

    def __init__(
        self, theme: Theme, field: str, title: str, proposal: FieldProposal | None, *, topic: str = ""
    ) -> None:
        super().__init__()
        self.setObjectName(f"mapping_{field}")
        self.proposal = proposal
        name = label(tr(title), wraps=True)
        name.setFixedWidth(170)
        self._icon = IconLabel(theme)
        self._verdict = ElidedLabel(objectName="mapping_verdict")
        self.box = DropDown(theme, f"mapping_{field}_box", tr(title))
        self.box.setMaxVisibleItems(_SHORT_LIST)
        chosen: QWidget = self.box
        if proposal is None:
            chosen = label(topic, toolTip=topic)
            self.box.hide()
            self.box.setParent(self)
        else:
            self.box.addItem(tr(NOT_USED), "")
            for candidate in proposal.candidates:
                self.box.addItem(candidate.value, candidate.value)
                tip = f"{candidate.type}\n{tr(candidate.why)}".strip()
                self.box.setItemData(self.box.count() - 1, tip, Qt.ItemDataRole.ToolTipRole)
            self.box.setCurrentIndex(max(0, self.box.findData(proposal.value)))
            self.box.setEnabled(bool(proposal.candidates))
            self.box.activated.connect(lambda _index: self.show_check(None))
        chosen.setFixedWidth(270)
        layouts.hbox(self, name, chosen, self._icon, (self._verdict, 1), margins_px=(0, 1, 0, 1), spacing_px=8)
        self.show_check(None)

    @property
    def value(self) -> str:
        """Selected ROS name; empty for none."""
        return str(self.box.currentData() or "")

    def show_check(self, check: "StreamCheck | None") -> None:
        """Show the result of a check; None for the reason of the proposal."""
        icon, role = ("", "") if check is None else _CHECK_LOOKS[check.state][:2]
        self._icon.show_icon(icon, role)
        self._verdict.setText(self._reason() if check is None else rate_words(check))
        restyle(self._verdict, role="note" if check is None else "small")

    def _reason(self) -> str:
        if self.proposal is None:
            return ""
        if not self.proposal.candidates:
            return tr("the robot offers nothing suitable")
        chosen = next((each for each in self.proposal.candidates if each.value == self.value), None)
        if chosen is not None:
            return tr(chosen.why)
        return tr("left out") if self.proposal.value else tr(self.proposal.why)
