"""Photos panel: searchable grid, enlarged photo, tags and commands."""

from collections.abc import Iterable, Sequence
from datetime import datetime
from functools import lru_cache, partial
from operator import attrgetter

from PySide6.QtCore import (
    QAbstractItemModel,
    QModelIndex,
    QRect,
    QRectF,
    QSize,
    Qt,
    Signal,
)
from PySide6.QtGui import (
    QAccessible,
    QImage,
    QKeyEvent,
    QPainter,
    QPen,
    QPixmap,
    QResizeEvent,
    QStandardItem,
)
from PySide6.QtWidgets import (
    QAbstractItemView,
    QBoxLayout,
    QLabel,
    QListView,
    QSizePolicy,
    QStackedLayout,
    QStyleOptionViewItem,
    QWidget,
)

from caris_desktop.domain import intents
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.status import PhotoEntry
from caris_desktop.people.presence import PersonRow
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.panel import Panel, PanelContext, show_part
from caris_desktop.ui.theme import Theme, draw_icon
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.inputs import DropDown, SubmitLineEdit, add_clear_button
from caris_desktop.ui.widgets.labels import ElidedLabel, label, named
from caris_desktop.ui.widgets.pictures import image_of
from caris_desktop.ui.widgets.rows import VALUE_ROLE, Index, KeyedItems, RowDelegate, set_up_list

_TILE = QSize(160, 148)
_PICTURE_PX = 100
_EDGE_PX = 6
_ABOUT_ROLE = VALUE_ROLE + 1
_LOW_PX = 300
_GRID, _LARGE, _EMPTY = range(3)
_TO_ASK = QT_TR_NOOP("Ask the assistant about this photo, then Enter")
_ASKED = QT_TR_NOOP("The answer appears in the Assistant panel. Ask more, then Enter")


class PhotosPanel(Panel):
    """Grid of photos, newest first, or the selected photo enlarged."""

    title = QT_TR_NOOP("Photos")
    preferred_size, least_size = QSize(360, 320), QSize(220, 160)
    reads = ("permissions.assistant", "assistant.pictures")

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("photos_panel")
        self._names: dict[str, str] = {}
        self._open = ""  # file name of the enlarged photo
        self.search = SubmitLineEdit(objectName="photo_search", placeholderText=tr("Name, tag, camera or time"))
        self.search.setAccessibleName(tr("Find photos by name, tag, camera or time"))
        add_clear_button(self.search)
        self.search.textChanged.connect(self._refresh)
        self.choice = DropDown(self.theme, "photo_filter", tr("Photo filter"), minimumContentsLength=8)
        self.choice.activated.connect(self._refresh)
        self._finding = QWidget()
        around = (10, 6, 10, 2)
        layouts.hbox(self._finding, (self.search, 3), (self.choice, 2), margins_px=around, spacing_px=tokens.GRID_PX)
        self.model = KeyedItems[PhotoEntry](self, attrgetter("file_name"), self._fill)
        self.grid = PhotoGrid(self.theme, self.model)
        self.grid.chosen.connect(self.open)
        permissions, assistant = self.console.scenario.permissions, self.console.scenario.assistant
        self.large = LargePhoto(self.theme, can_ask=permissions.assistant and assistant.pictures)
        self.large.left.connect(self.close_photo)
        self.large.requested.connect(self.console.do)
        self._empty = label(tone="dim", wraps=True, objectName="photos_empty", alignment=Qt.AlignmentFlag.AlignCenter)
        self._empty.setContentsMargins(24, 8, 24, 8)
        holder = QWidget()
        self._stack = QStackedLayout(holder)
        for part in (self.grid, self.large, self._empty):
            self._stack.addWidget(part)
        layouts.vbox(self, self._finding, (holder, 1), margins_px=(2, 0, 2, 8), spacing_px=2)
        self.hold.escape_pressed.connect(self.close_photo)
        self.watch(self._refresh, self.state.photos.changed, self.table.keys_changed)
        self.watch(self._on_persons_changed, self.state.persons.changed)
        self.update_view()

    def update_view(self) -> None:
        self._on_persons_changed(self.state.persons.value)
        self._refresh()

    def open(self, file_name: str) -> None:
        """Enlarge this photo."""
        self._open = file_name
        self._refresh()

    def close_photo(self) -> None:
        """Return to the grid."""
        if self._open:
            self._open = ""
            self._refresh()

    def _on_persons_changed(self, persons: tuple[PersonRow, ...]) -> None:
        names = {person.person_id: text_formatting.person_name(person) for person in persons}
        if names != self._names:
            self._names = names
            self.model.fill_again()
            self._refresh()

    def _refresh(self, _value: object = None) -> None:
        photos: tuple[PhotoEntry, ...] = self.state.photos.value
        self._offer_choices(photos)
        chosen = self.choice.currentData()
        matching = [photo for photo in photos if fits(photo, self.search.text(), chosen, self._names)]
        self.model.show_values(matching)
        large = next((photo for photo in photos if photo.file_name == self._open), None)
        if large is None:
            self._open = ""
        else:
            self.large.show_photo(large, self._names)
        self._finding.setVisible(bool(photos) and large is None)
        self._stack.setCurrentIndex(_LARGE if large is not None else _GRID if matching else _EMPTY)
        self._empty.setText(_nothing_words(photos, live=self.state.present.live, key=self.table.key_text("photo")))
        there = sum(not photo.deleted for photo in photos)
        found = sum(not photo.deleted for photo in matching)
        part = tr("{found} of %n photos", "", there).format(found=found)
        self.set_fact(part if found != there else tr("1 photo") if there == 1 else tr("%n photos", "", there), "dim")

    def _fill(self, item: QStandardItem, photo: PhotoEntry) -> None:
        about = (*people_of(photo, self._names), *photo.tags)
        said = ", ".join((time_of(photo), *about))
        item.setText((tr("Deleted photo, {said}") if photo.deleted else tr("Photo, {said}")).format(said=said))
        item.setData(", ".join(about) or text_formatting.camera_title(photo.camera), _ABOUT_ROLE)

    def _offer_choices(self, photos: Iterable[PhotoEntry]) -> None:
        """Offer filters by person, tag and camera, as far as there are photos."""
        offered: dict[tuple[str, str], str] = {}
        for photo in photos:
            for person_id in photo.person_ids:
                if person_id in self._names:
                    offered["person", person_id] = self._names[person_id]
            for tag in photo.tags:
                offered["tag", tag] = tr("Tag: {tag}").format(tag=tag)
            if photo.camera:
                offered["camera", photo.camera] = text_formatting.camera_title(photo.camera)
        order = ("person", "tag", "camera")
        listed = sorted(offered.items(), key=lambda item: (order.index(item[0][0]), item[1].casefold()))
        chosen = self.choice.currentData()
        items = [(tr("All photos"), None), *((text, data) for data, text in listed)]
        self.choice.fill(items, chosen if chosen in offered else None)


def _nothing_words(photos: Sequence[PhotoEntry], *, live: bool, key: str) -> str:
    if photos:
        return tr("No photos match.\nClear the field, or choose all photos.")
    if not live:
        return tr("No photos had been taken by this moment.")
    how = tr("No photos yet.\n{key} takes a photo of the current picture.").format(key=key)
    return how if key else tr("No photos yet.")


def fits(photo: PhotoEntry, text: str, chosen: tuple[str, str] | None, names: dict[str, str]) -> bool:
    """Whether the photo has every word of ``text`` in its description and matches the filter ``chosen``."""
    if chosen is not None:
        kind, value = chosen
        has = {"person": photo.person_ids, "tag": photo.tags, "camera": (photo.camera,)}[kind]
        if value not in has:
            return False
    searched = " ".join(
        (time_of(photo), text_formatting.camera_title(photo.camera), *people_of(photo, names), *photo.tags)
    )
    return all(word in searched.casefold() for word in text.casefold().split())


def time_of(photo: PhotoEntry) -> str:
    """Time of a photo as 14:02:11, with the date if not today."""
    at = text_formatting.local_moment(photo.utc_ns)
    return at.strftime("%H:%M:%S" if at.date() == datetime.now().date() else "%Y-%m-%d %H:%M:%S")


def people_of(photo: PhotoEntry, names: dict[str, str]) -> list[str]:
    """People in the photo, by current name."""
    known = [names[person_id] for person_id in photo.person_ids if person_id in names]
    others = len(photo.person_ids) - len(known)
    if not others:
        return known
    alone = tr("1 person") if others == 1 else tr("%n people", "", others)
    return [*known, tr("%n more", "", others) if known else alone]


class PhotoGrid(QListView):
    """Grid of equal tiles."""

    chosen = Signal(str)  # file name

    def __init__(self, theme: Theme, model: QAbstractItemModel) -> None:
        super().__init__()
        named(self, "photo_grid", tr("Photos, newest first"))
        self.setModel(model)
        self.setItemDelegate(PhotoDelegate(theme, self))
        set_up_list(self)
        self.setViewMode(QListView.ViewMode.IconMode)
        self.setMovement(QListView.Movement.Static)
        self.setResizeMode(QListView.ResizeMode.Adjust)
        self.setUniformItemSizes(True)
        self.setGridSize(_TILE)
        self.setSelectionMode(QAbstractItemView.SelectionMode.NoSelection)
        self.clicked.connect(self._on_chosen)

    def keyboardSearch(self, _search: str) -> None:
        """Disabled: letters are for driving and the search field."""

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter) and self.currentIndex().isValid():
            self._on_chosen(self.currentIndex())
        else:
            super().keyPressEvent(event)

    def _on_chosen(self, index: QModelIndex) -> None:
        photo: PhotoEntry = index.data(VALUE_ROLE)
        self.chosen.emit(photo.file_name)


class PhotoDelegate(RowDelegate):
    """Tile with thumbnail, time and contents. Thumbnails are decoded when first visible."""

    def __init__(self, theme: Theme, view: PhotoGrid) -> None:
        super().__init__(theme, view)
        self._view = view
        self._picture = lru_cache(maxsize=400)(image_of)

    def sizeHint(self, _option: QStyleOptionViewItem, _index: Index) -> QSize:
        return _TILE

    def paint_row(self, painter: QPainter, rect: QRect, index: Index) -> None:
        theme, photo = self._theme, index.data(VALUE_ROLE)
        tile = rect.adjusted(_EDGE_PX, _EDGE_PX, -_EDGE_PX, 0)
        ground = QRect(tile.left(), tile.top(), tile.width(), _PICTURE_PX)
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(theme.color("video_ground"))
        painter.drawRoundedRect(QRectF(ground), 6, 6)
        if photo.deleted:
            draw_icon(painter, QRectF(ground.center().x() - 14, ground.center().y() - 14, 28, 28), "trash",
                      theme.color("video_dim"))  # fmt: skip
        else:
            picture = self._picture(photo.thumbnail_jpeg)
            size = picture.size().scaled(ground.size(), Qt.AspectRatioMode.KeepAspectRatio)
            left, top = ground.center().x() - size.width() // 2, ground.center().y() - size.height() // 2
            painter.drawImage(QRect(left, top, size.width(), size.height()), picture)
        if self._view.hasFocus() and index.row() == self._view.currentIndex().row():
            painter.setPen(QPen(theme.color("blue"), 2))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawRoundedRect(QRectF(ground).adjusted(1, 1, -1, -1), 6, 6)
        lines = (
            (time_of(photo), theme.font(tokens.STATUS_PX, tokens.WEIGHT_SEMIBOLD), "dim" if photo.deleted else "text"),
            (tr("Deleted") if photo.deleted else index.data(_ABOUT_ROLE), theme.font(tokens.STATUS_PX), "dim"),
        )
        for number, (text, font, role) in enumerate(lines):
            line = QRect(tile.left() + 2, ground.bottom() + 3 + 18 * number, tile.width() - 4, 18)
            self.paint_text(painter, line, text, font, role)


class LargePhoto(QWidget):
    """Enlarged photo with description, tags and commands."""

    left = Signal()
    requested = Signal(object)  # Intent

    def __init__(self, theme: Theme, *, can_ask: bool) -> None:
        super().__init__()
        self._photo: PhotoEntry | None = None
        self.picture = _Picture()
        self.about = ElidedLabel(objectName="photo_about")
        self.tags = SubmitLineEdit(objectName="photo_tags", maxLength=400, returnPressed=self._on_tags_entered)
        self.tags.setPlaceholderText(tr("Tags separated by commas, then Enter"))
        self.tags.setAccessibleName(tr("Tags of this photo"))
        self.question = SubmitLineEdit(objectName="photo_question", maxLength=1000, placeholderText=tr(_TO_ASK))
        self.question.setAccessibleName(tr("Question to the assistant about this photo"))
        self.question.returnPressed.connect(self._on_question_entered)
        button = partial(ActionButton, theme, role="ghost", height_px=30)
        back = button(tr("All photos"), icon="arrow-left", objectName="photo_back", clicked=self.left)
        self._delete = button(tr("Delete"), icon="trash", objectName="photo_delete", clicked=self._on_delete)
        fields = QWidget()
        layouts.vbox(fields, self.about, self.tags, self.question, 1, margins_px=0, spacing_px=6)
        self.question.setHidden(not can_ask)
        self._body: QBoxLayout = layouts.vbox(None, (self.picture, 1), fields, spacing_px=tokens.GRID_PX)
        buttons = layouts.hbox(None, back, 1, self._delete)
        layouts.vbox(self, buttons, (self._body, 1), margins_px=(10, 6, 10, 2), spacing_px=6)

    def resizeEvent(self, event: QResizeEvent) -> None:
        """In a low panel, put the text next to the photo."""
        super().resizeEvent(event)
        low = self.height() < _LOW_PX and self.width() > self.height()
        self._body.setDirection(QBoxLayout.Direction.LeftToRight if low else QBoxLayout.Direction.TopToBottom)
        self._body.setStretch(1, 1 if low else 0)

    def show_photo(self, photo: PhotoEntry, names: dict[str, str]) -> None:
        before, self._photo = self._photo, photo
        other = before is None or before.file_name != photo.file_name
        self.picture.show_jpeg(b"" if photo.deleted else photo.preview_jpeg)
        pose = photo.pose_in_map
        where = "" if pose is None else tr("robot at {x:.1f}, {y:.1f} m").format(x=pose.x_m, y=pose.y_m)
        parts = (time_of(photo), text_formatting.camera_title(photo.camera), ", ".join(people_of(photo, names)), where)
        self.about.setText(" · ".join(part for part in parts if part))
        if other or (before is not None and before.tags != photo.tags):
            self.tags.setText(", ".join(photo.tags))
        if other:
            self.question.clear()
            self.question.setPlaceholderText(tr(_TO_ASK))
        show_part(self.tags, (photo.changeable and not photo.deleted) or bool(photo.tags))
        self.tags.setReadOnly(not photo.changeable or photo.deleted)
        show_part(self._delete, photo.changeable)
        self._delete.set_label(
            tr("Restore") if photo.deleted else tr("Delete"),
            icon="arrow-counter-clockwise" if photo.deleted else "trash",
        )
        self.question.setEnabled(not photo.deleted)

    def _on_delete(self) -> None:
        if self._photo is not None:
            do_or_undo = intents.RestorePhoto if self._photo.deleted else intents.DeletePhoto
            self.requested.emit(do_or_undo(self._photo.file_name))

    def _on_tags_entered(self) -> None:
        if self._photo is not None and not self.tags.isReadOnly():
            tags = tuple(tag.strip() for tag in self.tags.text().split(",") if tag.strip())
            self.requested.emit(intents.TagPhoto(self._photo.file_name, tags))

    def _on_question_entered(self) -> None:
        question = self.question.text().strip()
        if self._photo is not None and question:
            self.requested.emit(intents.AskAboutPhoto(self._photo.file_name, question))
            self.question.clear()
            self.question.setPlaceholderText(tr(_ASKED))


class _Picture(QLabel):
    """Scaled picture, or a note that it was deleted."""

    accessible_role = QAccessible.Role.Graphic

    def __init__(self) -> None:
        super().__init__(alignment=Qt.AlignmentFlag.AlignCenter, wordWrap=True)
        self.setObjectName("photo_large")
        self.setProperty("tone", "dim")
        self.setAccessibleName(tr("The photo"))
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Ignored)
        self.setMinimumSize(120, 60)
        self._jpeg = b""
        self.image = QImage()

    def show_jpeg(self, jpeg: bytes) -> None:
        """Show a picture; nothing if empty."""
        if jpeg != self._jpeg:
            self._jpeg, self.image = jpeg, image_of(jpeg) if jpeg else QImage()
        self._fit()

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._fit()

    def _fit(self) -> None:
        if self.image.isNull():
            self.setText(tr("Deleted. You can restore it until the session ends."))
            return
        ratio, how = self.devicePixelRatioF(), Qt.TransformationMode.SmoothTransformation
        scaled = self.image.scaled(self.size() * ratio, Qt.AspectRatioMode.KeepAspectRatio, how)
        scaled.setDevicePixelRatio(ratio)
        self.setPixmap(QPixmap.fromImage(scaled))
