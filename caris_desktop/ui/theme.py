"""Theme: Fusion palette, font and style sheet from the tokens, by the system's or the user's choice; drawings
cached as pixmaps; Phosphor icons, drawn in any colour.
"""

import json
import logging
from collections.abc import Callable
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from PySide6.QtCore import QObject, QPointF, QRectF, QSize, QSizeF, Qt, Signal
from PySide6.QtGui import (
    QColor,
    QFont,
    QFontDatabase,
    QGuiApplication,
    QIcon,
    QPaintEngine,
    QPainter,
    QPalette,
    QPixmap,
    QPixmapCache,
)
from PySide6.QtWidgets import QApplication

from caris_desktop.ui import tokens
from caris_desktop.ui.tokens import DARK, LIGHT, Colors


def draw_cached(
    painter: QPainter, at: QPointF, size: QSizeF, key: tuple[object, ...], paint: Callable[[QPainter], None]
) -> None:
    """Draw at ``at`` what ``paint`` draws from (0, 0) to ``size``, by Qt's pixmap cache. GUI thread only.

    Text and round corners are the most expensive part of a video frame with boxes, names and labels, and would be
    repainted with each frame of the robot's camera. ``key`` must hold everything the drawing depends on except its
    size, the theme and the screen scale of ``painter``.
    """
    if size.isEmpty():
        return
    engine, device = painter.paintEngine(), painter.device()
    if engine is not None and engine.type() is not QPaintEngine.Type.Raster:
        # A vector paint device, such as one that tests inspect, gets the drawing itself.
        painter.save()
        painter.translate(at)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        paint(painter)
        painter.restore()
        return
    ratio = device.devicePixelRatioF() if device is not None else 1.0
    name, picture = repr((key, size.toTuple(), ratio)), QPixmap()
    if not QPixmapCache.find(name, picture):
        picture = QPixmap((size * ratio).toSize().expandedTo(QSize(1, 1)))
        picture.setDevicePixelRatio(ratio)
        picture.fill(Qt.GlobalColor.transparent)
        onto = QPainter(picture)
        onto.setRenderHint(QPainter.RenderHint.Antialiasing)
        paint(onto)
        onto.end()
        QPixmapCache.insert(name, picture)
    # Aligned to whole pixels, the copy stays sharp.
    painter.drawPixmap(QPointF(round(at.x() * ratio) / ratio, round(at.y() * ratio) / ratio), picture)


ThemeChoice = Literal["system", "dark", "light"]
CHOICES: tuple[ThemeChoice, ...] = ("system", "dark", "light")
THEME_KEY = "appearance/theme"
SCALE_KEY = "appearance/scale"
SCALES = ("", "1.25", "1.5", "1.75", "2")
"""Scale factors relative to the system's; empty for the system's own."""

_CACHED_KIB = 32 * 1024  # the buttons of a scenario at twice the size
# Used only if the system has no proper default font, as on a bare Debian with DejaVu alone.
_GOOD_FAMILIES = ("Inter", "Inter Variable", "Noto Sans", "Cantarell", "Ubuntu", "Liberation Sans", "DejaVu Sans")
_FALLBACK_FAMILIES = ("DejaVu Sans", "DejaVu Serif", "Sans Serif", "Sans", "Bitstream Vera Sans", "")


def as_choice(value: object) -> ThemeChoice:
    """Theme choice from a stored setting; unknown values follow the system."""
    for choice in CHOICES:
        if value == choice:
            return choice
    return "system"


class Theme(QObject):
    """Current colours and fonts. Qt repaints every widget for a new style sheet; ``changed`` is for stored colours."""

    changed = Signal()

    def __init__(self, app: QApplication, choice: ThemeChoice = "system", parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._app = app
        self.choice: ThemeChoice = choice
        self.family = _pick_family()
        self._fonts: dict[tuple[int, int], QFont] = {}
        QPixmapCache.setCacheLimit(_CACHED_KIB)
        self.colors: Colors = DARK
        app.setStyle("Fusion")
        self._system_scheme = QGuiApplication.styleHints().colorScheme()
        QGuiApplication.styleHints().colorSchemeChanged.connect(self._on_system_scheme_changed)
        self._apply()

    def set_choice(self, choice: ThemeChoice) -> None:
        if choice != self.choice:
            self.choice = choice
            self._apply()

    def color(self, role: str) -> QColor:
        return QColor(getattr(self.colors, role))

    def font(self, size_px: int = tokens.BODY_PX, weight: int = tokens.WEIGHT_NORMAL) -> QFont:
        """Cached font of this size and weight: looking up a typeface costs more than drawing."""
        font = self._fonts.get((size_px, weight))
        if font is None:
            font = QFont(self.family)
            font.setPixelSize(size_px)
            font.setWeight(QFont.Weight(weight))
            self._fonts[size_px, weight] = font
        return font

    def restyle_on_change(self, style: Callable[[], object]) -> None:
        """Call ``style`` now and whenever the theme changes."""
        self.changed.connect(style)
        style()

    def _on_system_scheme_changed(self, scheme: Qt.ColorScheme) -> None:
        self._system_scheme = scheme
        if self.choice == "system":
            self._apply()

    def _apply(self) -> None:
        self.colors = colors_for(self.choice, self._system_scheme)
        QPixmapCache.clear()
        self._app.setPalette(make_palette(self.colors))
        self._app.setFont(self.font())
        self._app.setStyleSheet(make_style_sheet(self.colors))
        self.changed.emit()


def colors_for(choice: ThemeChoice, system_scheme: Qt.ColorScheme) -> Colors:
    """Colours of the user's choice, else the system's; dark if the system has none."""
    if choice == "system":
        return LIGHT if system_scheme == Qt.ColorScheme.Light else DARK
    return DARK if choice == "dark" else LIGHT


def _pick_family() -> str:
    system = QFontDatabase.systemFont(QFontDatabase.SystemFont.GeneralFont).family()
    if system not in _FALLBACK_FAMILIES:
        return system
    present = set(QFontDatabase.families())
    return next((family for family in _GOOD_FAMILIES if family in present), system)


def make_palette(colors: Colors) -> QPalette:
    role = QPalette.ColorRole
    palette = QPalette()
    for which, name in (
        (role.Window, colors.window), (role.WindowText, colors.text), (role.Base, colors.field),
        (role.AlternateBase, colors.panel), (role.Text, colors.text), (role.Button, colors.raised),
        (role.ButtonText, colors.text), (role.BrightText, colors.red), (role.Highlight, colors.blue),
        (role.HighlightedText, colors.on_blue), (role.Link, colors.blue), (role.ToolTipBase, colors.raised),
        (role.ToolTipText, colors.text), (role.PlaceholderText, colors.dim), (role.Accent, colors.blue),
        (role.Light, colors.raised_hover), (role.Mid, colors.line), (role.Dark, colors.line),
    ):  # fmt: skip
        palette.setColor(which, QColor(name))
    for which in (role.WindowText, role.Text, role.ButtonText):
        palette.setColor(QPalette.ColorGroup.Disabled, which, QColor(colors.dim))
    return palette


def make_style_sheet(colors: Colors) -> str:
    """Style sheet for what a palette lacks: corners, borders, spacing."""
    radius, status = tokens.CONTROL_RADIUS_PX, tokens.STATUS_PX
    return f"""
/* Qt takes what looks like HTML in a label or a tooltip for HTML, and reads the files that it names. Names, answers of
models and errors of servers are shown there: they stay words, but where the program writes the HTML itself. The sheet
applies when a label is first laid out or shown: one that is asked for its heightForWidth before sets its format. */
QLabel, QToolTip {{ qproperty-textFormat: PlainText; }}
QLabel#known_names, QLabel#map_legend {{ qproperty-textFormat: RichText; }}
QWidget#split_handle {{ background: transparent; }}
QFrame#people_undo {{ background: {colors.blue_soft}; margin: 0 1px; }}
QWidget#split_handle:hover:enabled {{ background: {colors.line_strong}; }}
QPushButton#more_tabs {{ background: transparent; color: {colors.dim}; border: 0; border-radius: {radius}px; }}
QPushButton#more_tabs:hover, QPushButton#more_tabs:focus {{ color: {colors.text}; background: {colors.raised}; }}
QFrame#drop_mark {{
    /* Translucent: the content below helps to aim. */
    background: #46{colors.blue[1:]}; border: 3px solid {colors.blue}; border-radius: {tokens.PANEL_RADIUS_PX}px;
}}
QLabel#drag_words {{
    background: {colors.raised}; color: {colors.text}; border: 1px solid {colors.blue}; padding: 5px 10px;
}}
QLineEdit, QPlainTextEdit, QComboBox {{
    background: {colors.field}; color: {colors.text}; border: 1px solid {colors.line_strong};
    border-radius: {radius}px; padding: 5px 10px; selection-background-color: {colors.blue};
    selection-color: {colors.on_blue}; placeholder-text-color: {colors.dim};
}}
QLineEdit:focus, QPlainTextEdit:focus, QComboBox:focus {{ border: 2px solid {colors.blue}; padding: 4px 9px; }}
QLineEdit:disabled, QPlainTextEdit:disabled {{ color: {colors.dim}; background: {colors.panel}; }}
QPlainTextEdit#speak_field, QPlainTextEdit#speak_field:focus {{ font-size: {tokens.SPEECH_PX}px; padding: 0; }}
QPlainTextEdit#transcript_field, QPlainTextEdit#assistant_answer {{ font-size: {tokens.SPEECH_PX - 1}px; }}
QPlainTextEdit#assistant_answer[readOnly="true"] {{
    background: transparent; border-color: transparent; padding: 2px 0;
}}
QComboBox {{ padding: 4px 8px; }}
QDialogButtonBox {{ dialogbuttonbox-buttons-have-icons: 0; }}
QDialogButtonBox QPushButton {{
    background: {colors.raised}; border: 1px solid {colors.line}; border-radius: {radius}px; padding: 6px 16px;
}}
QDialogButtonBox QPushButton:default {{ background: {colors.blue}; color: {colors.on_blue}; }}
QDialogButtonBox QPushButton:disabled {{ background: {colors.raised}; color: {colors.dim}; }}
QDialogButtonBox QPushButton:focus {{ border: 2px solid {colors.blue}; padding: 5px 15px; }}
QComboBox::drop-down {{ border: 0; width: 22px; }}
QComboBox QAbstractItemView, QMenu {{
    background: {colors.panel}; color: {colors.text}; border: 1px solid {colors.line_strong};
}}
QMenu {{ padding: 6px; }}
QMenu::item {{ padding: 7px 28px 7px 14px; border-radius: 6px; }}
QMenu::item:selected {{ background: {colors.blue_soft}; color: {colors.text}; }}
QMenu::item:disabled {{ color: {colors.dim}; }}
QMenu::separator {{ height: 1px; background: {colors.line}; margin: 6px 8px; }}
QToolTip {{
    background: {colors.raised}; color: {colors.text}; border: 1px solid {colors.line_strong}; padding: 6px 8px;
    font-size: {status}px;
}}
QTabBar {{ background: transparent; }}
QTabBar::tab {{
    background: transparent; color: {colors.dim}; padding: 6px 14px; margin-right: 4px; border: 0;
    border-bottom: 2px solid transparent;
}}
QTabBar::tab:hover {{ color: {colors.text}; }}
QTabBar::tab:selected {{ color: {colors.text}; border-bottom: 2px solid {colors.blue}; }}
QTabBar::tab:focus {{ color: {colors.blue}; }}
QScrollArea, QScrollArea > QWidget > QWidget, QListView {{ background: transparent; border: 0; }}
QTableView {{
    background: {colors.panel}; alternate-background-color: {colors.panel}; border: 1px solid {colors.line};
    border-radius: {radius}px; gridline-color: {colors.line}; selection-background-color: {colors.blue_soft};
    selection-color: {colors.text};
}}
QTableView::item {{ padding: 0 7px; border: 0; border-bottom: 1px solid {colors.line}; }}
QTableView#person_history::item, QTableView#diagnostics_table::item {{ padding: 0; border: 0; }}
QTableView::item:selected {{
    background: {colors.blue_soft}; color: {colors.text}; border-bottom: 1px solid {colors.blue};
}}
QTableView#diagnostics_table {{ background: transparent; border: 0; font-size: {status}px; }}
QTableView#diagnostics_table QHeaderView {{ background: transparent; }}
QTableView#diagnostics_table QHeaderView::section {{
    padding: 3px 4px; border-bottom: 1px solid {colors.line}; font-size: {status}px;
}}
FastTableView {{ background: transparent; border: 0; border-radius: 0; }}
QAbstractScrollArea::corner {{ background: transparent; border: 0; }}
QHeaderView, QTableView QTableCornerButton::section {{ background: {colors.panel}; border: 0; }}
QHeaderView::section {{
    background: {colors.panel}; color: {colors.dim}; border: 0; border-bottom: 1px solid {colors.line_strong};
    padding: 7px 10px; font-size: {status}px;
}}
QHeaderView::section:hover {{ color: {colors.text}; }}
QProgressBar {{
    background: {colors.raised}; border: 0; border-radius: 4px; min-height: 8px; max-height: 8px;
}}
QProgressBar::chunk {{ background: {colors.blue}; border-radius: 4px; }}
QProgressBar#hold_progress {{ background: transparent; min-height: 4px; max-height: 4px; margin: 0 3px; }}
QProgressBar#hold_progress::chunk {{ background: {colors.amber}; border-radius: 2px; }}
QSplitter::handle:vertical {{ height: 8px; background: transparent; }}
QScrollBar:vertical {{ width: 10px; background: transparent; margin: 0; }}
QScrollBar:horizontal {{ height: 10px; background: transparent; margin: 0; }}
QScrollBar::handle {{
    background: {colors.line_strong}; border-radius: 4px; min-height: 28px; min-width: 28px; margin: 1px;
}}
QScrollBar::add-line, QScrollBar::sub-line, QScrollBar::add-page, QScrollBar::sub-page {{
    background: transparent; width: 0; height: 0;
}}
QWidget[role="popup"] {{
    background: {colors.panel}; border: 1px solid {colors.line_strong}; border-radius: {tokens.PANEL_RADIUS_PX}px;
}}
QWidget[role="panel_title"], QWidget[role="panel"] {{ background: {colors.panel}; border: 1px solid {colors.line}; }}
QWidget[role="panel_title"] {{
    border-top-left-radius: {tokens.PANEL_RADIUS_PX}px; border-top-right-radius: {tokens.PANEL_RADIUS_PX}px;
}}
QWidget[role="panel"] {{
    border-top: 0;
    border-bottom-left-radius: {tokens.PANEL_RADIUS_PX}px; border-bottom-right-radius: {tokens.PANEL_RADIUS_PX}px;
}}
QWidget[role="panel_title"][active="true"], QWidget[role="panel"][active="true"] {{ border-color: {colors.blue}; }}
QWidget[role="panel_title"][active="true"] {{ border-bottom-color: {colors.line}; }}
QWidget#practice_strip {{
    background: {colors.panel}; border: 1px solid {colors.blue}; border-radius: {tokens.PANEL_RADIUS_PX}px;
    margin: 1px 8px;
}}
QWidget#top_bar, QWidget#protocol_strip {{
    background: {colors.panel}; border-bottom: 1px solid {colors.line};
}}
QWidget#status_bar {{ background: {colors.panel}; border-top: 1px solid {colors.line}; }}
QLabel#replay_badge {{
    background: {colors.blue}; color: {colors.on_blue}; border-radius: {radius}px; padding: 6px 12px;
    font-weight: {tokens.WEIGHT_SEMIBOLD};
}}
QLabel#welcome {{ font-size: 24px; }}
QPushButton[role="step"] {{ background: transparent; border: 0; border-radius: {radius}px; }}
QPushButton[role="step"]:checked, QPushButton[role="step"]:hover {{ background: {colors.raised}; }}
QPushButton[role="step"]:focus {{ border: 2px solid {colors.blue}; }}
QPushButton[role="pill"] {{
    background: {colors.raised}; color: {colors.dim}; border: 1px solid transparent; border-radius: 14px;
    padding: 0 11px; font-size: {status + 1}px; text-align: left;
}}
QPushButton[role="pill"]:hover {{ background: {colors.raised_hover}; }}
QPushButton[role="pill"][tone="blue"], QPushButton[role="pill"][tone="amber"] {{
    background: {colors.blue_soft}; color: {colors.text}; border-color: {colors.blue};
    font-weight: {tokens.WEIGHT_SEMIBOLD};
}}
QPushButton[role="pill"][tone="amber"] {{ background: {colors.amber_soft}; border-color: {colors.amber}; }}
QPushButton[role="pill"]:focus {{ border: 2px solid {colors.blue}; padding: 0 10px; }}
QPushButton[role="choice"] {{
    background: {colors.raised}; border: 1px solid {colors.line}; border-radius: {tokens.PANEL_RADIUS_PX}px;
}}
QPushButton[role="choice"]:hover {{ background: {colors.raised_hover}; border-color: {colors.blue}; }}
QPushButton[role="choice"][tone="blue"] {{ background: {colors.blue_soft}; border-color: {colors.blue}; }}
QPushButton[role="choice"]:focus {{ border: 2px solid {colors.blue}; }}
QWidget#gamepad_view, QFrame#speed_frame {{
    background: {colors.raised}; border: 1px solid {colors.line}; border-radius: {radius}px;
}}
QFrame#curve_round_trip {{ border: 0; border-top: 2px solid {colors.blue}; }}
QFrame#curve_video {{ border: 0; border-top: 2px dashed {colors.green}; }}
QFrame#curve_lidar {{ border: 0; border-top: 2px dotted {colors.amber}; }}
Overlay {{ background: {colors.shadow}; }}
QFrame#sign {{ margin: 1px; border: 1px solid {colors.line}; padding: 1px; border-radius: {radius}px; }}
QFrame#sign[tone="half"] {{ background: {colors.amber_soft}; border: 2px dashed {colors.amber}; padding: 0; }}
QFrame#sign[tone="blue"] {{ background: {colors.blue}; border-color: {colors.blue}; }}
QFrame#sign[tone="green"] {{ background: {colors.green}; border-color: {colors.green}; }}
QLabel#sign_word[tone="panel"] {{ color: {colors.panel}; }}
QFrame#key_owner_pill {{ background: {colors.raised}; border: 1px solid {colors.line}; border-radius: 11px; }}
QFrame#key_owner_pill[tone="blue"] {{ background: {colors.blue_soft}; border-color: {colors.blue}; }}
QFrame#key_owner_pill[tone="amber"] {{ background: {colors.amber_soft}; border-color: {colors.amber}; }}
QLabel#step_dot {{
    background: {colors.raised}; border: 1px solid {colors.dim}; border-radius: 11px;
    font-size: {status - 2}px; font-weight: {tokens.WEIGHT_SEMIBOLD};
}}
QLabel#step_dot[tone="green"] {{ border-color: {colors.green}; }}
QLabel#step_dot[tone="blue"] {{ border: 2px solid {colors.blue}; }}
QWidget[role="card"] {{
    background: {colors.panel}; border: 1px solid {colors.line_strong}; border-radius: 12px;
}}
QWidget[role="banner"] {{ border-radius: {tokens.PANEL_RADIUS_PX}px; }}
{_tones(colors)}
QLabel[role="hint"] {{
    background: {colors.amber_soft}; border: 1px solid {colors.amber}; border-radius: {radius}px; color: {colors.text};
    padding: 10px;
}}
QLabel[role="caption"] {{ font-size: {status}px; font-weight: {tokens.WEIGHT_SEMIBOLD}; }}
QLabel[role="detail"], QLabel[role="fine"], QLineEdit#queue_editor, QPlainTextEdit#person_note,
QTableView#sessions_table {{ font-size: {status + 1}px; }}
QLabel#person_card_name {{ font-size: {tokens.BODY_PX + 2}px; font-weight: {tokens.WEIGHT_SEMIBOLD}; }}
QTableView#person_history {{ font-size: {status}px; }}
QLabel[role="fine"] {{ color: {colors.dim}; }}
QLabel[role="title"], QLabel[role="heading"], QLabel[role="time"] {{ font-weight: {tokens.WEIGHT_SEMIBOLD}; }}
QLabel[role="heading"], QLabel[role="time"], QLabel#completion {{ font-size: {tokens.SPEECH_PX}px; }}
QLabel[role="medium"] {{ font-weight: {tokens.WEIGHT_MEDIUM}; }}
QTextBrowser#help_page {{ background: {colors.panel}; border: 0; padding: 4px 4px 4px 14px; }}
QWidget#export_dialog {{ background: {colors.panel}; }}
QLabel[role="small"], QCheckBox[role="small"] {{ font-size: {status}px; }}
QLabel[role="drive"] {{ font-size: {tokens.SPEECH_PX - 1}px; font-weight: {tokens.WEIGHT_SEMIBOLD}; }}
QLabel[role="moment"] {{ font-size: {status}px; font-weight: {tokens.WEIGHT_MEDIUM}; }}
QLabel[role="note"] {{ color: {colors.dim}; font-size: {status}px; }}
QWidget[role="readout"] {{ border: 1px solid {colors.line}; border-radius: {radius}px; }}
QLabel[role="key"] {{
    background: {colors.key_ground}; color: {colors.text}; border: 1px solid {colors.key_line}; border-radius: 4px;
    padding: 0 5px; min-width: 8px; font-size: {tokens.KEY_CAP_PX}px; font-weight: {tokens.WEIGHT_SEMIBOLD};
}}
QLabel[role="warning"] {{ color: {colors.amber}; font-size: {status}px; }}
QLabel[role="news"] {{ color: {colors.blue}; font-size: {status}px; }}
QLabel[role="refusal"] {{
    background: {colors.amber_soft}; border: 1px solid {colors.amber}; border-radius: {radius}px;
    color: {colors.text}; font-size: {status}px;
}}
QPushButton#speed_step {{
    background: transparent; border: 1px solid transparent; border-radius: {radius}px; padding: 0 5px;
    color: {colors.dim}; font-size: {status}px;
}}
QPushButton#speed_step:checked {{
    background: {colors.blue_soft}; border-color: {colors.blue}; color: {colors.text};
    font-weight: {tokens.WEIGHT_SEMIBOLD};
}}
QFrame#queue_row, QFrame#exchange_row {{ border: 1px solid transparent; border-radius: 6px; }}
QFrame#queue_row {{ margin: 1px 0; }}
QFrame#queue_row[current="true"] {{ background: {colors.blue_soft}; border-color: {colors.blue}; }}
QFrame#exchange_row[current="true"] {{ background: {colors.raised}; border-color: {colors.raised}; }}
QLineEdit#tier_filter, QListView#label_list, QTableView#agreement_table {{ font-size: {status}px; }}
QLabel#agreement_kappa {{ font-size: 28px; font-weight: {tokens.WEIGHT_SEMIBOLD}; }}
QWidget#replay_bar {{ background: {colors.panel}; border-top: 1px solid {colors.line}; }}
QLabel#replay_title {{
    background: {colors.blue_soft}; border-radius: 16px; padding: 6px 14px; font-weight: {tokens.WEIGHT_MEDIUM};
}}
QFrame#moment_bubble {{
    background: {colors.panel}; border: 1px solid {colors.line_strong}; border-radius: {radius}px;
}}
QWidget#photo_thumbnail {{
    background: {colors.video_chip}; border: 1px solid {colors.video_line}; border-radius: {radius}px;
}}
QWidget#photo_thumbnail > QLabel[role="small"] {{ color: {colors.video_text}; }}
QLabel#moment_picture, QLabel#first_use_picture {{ background: {colors.video_ground}; color: {colors.video_dim}; }}
QSlider#replay_scrubber:focus {{ border: 2px solid {colors.blue}; border-radius: {radius}px; }}
QSlider:horizontal {{ min-height: 20px; }}
QSlider::groove:horizontal {{ height: 4px; border-radius: 2px; background: {colors.line_strong}; }}
QSlider::sub-page:horizontal {{ height: 4px; border-radius: 2px; background: {colors.blue}; }}
QSlider::handle:horizontal {{
    width: 12px; height: 12px; margin: -6px 0; border-radius: 8px; background: {colors.panel};
    border: 2px solid {colors.blue};
}}
QSlider::sub-page:horizontal:disabled {{ background: {colors.line_strong}; }}
QSlider::handle:horizontal:disabled {{ border-color: {colors.dim}; }}
"""


def _tones(colors: Colors) -> str:
    """Texts, and edges of popups and banners, in the colour of their state or severity."""
    rules = [f'QLabel[tone="{tone}"] {{ color: {getattr(colors, tone)}; }}' for tone in ("text", "dim")]
    for tone in ("blue", "green", "amber", "red"):
        line, ground = getattr(colors, tone), getattr(colors, f"{tone}_soft")
        rules.append(f'QLabel[tone="{tone}"] {{ color: {line}; }}')
        rules.append(f'QWidget[role="popup"][tone="{tone}"] {{ border-color: {line}; }}')
        rules.append(f'QWidget[role="banner"][tone="{tone}"] {{ background: {ground}; border: 1px solid {line}; }}')
    return "\n".join(rules)


logger = logging.getLogger(__name__)


@lru_cache(maxsize=1)
def _font_files() -> tuple[Path, Path] | None:
    """Glyphs and names of qtawesome's font; its Python code is not imported, which would delay the first window by 0.25
    s.
    """
    spec = find_spec("qtawesome")
    if spec is None or spec.origin is None:
        return None
    fonts = Path(spec.origin).parent / "fonts"
    glyphs, names = sorted(fonts.glob("phosphor-*.ttf")), sorted(fonts.glob("phosphor-charmap-*.json"))
    return (glyphs[-1], names[-1]) if glyphs and names else None


@lru_cache(maxsize=1)
def _charmap() -> dict[str, str]:
    files = _font_files()
    return {} if files is None else json.loads(files[1].read_text())


@lru_cache(maxsize=1)
def _family() -> str | None:
    files = _font_files()
    font_id = -1 if files is None else QFontDatabase.addApplicationFont(str(files[0]))
    if font_id < 0:
        logger.warning("no Phosphor font found in qtawesome; the window shows no icons")
        return None
    return QFontDatabase.applicationFontFamilies(font_id)[0]


@lru_cache(maxsize=32)
def _font(family: str, size_px: int) -> QFont:
    font = QFont(family)
    font.setPixelSize(size_px)
    return font


def icon_names() -> frozenset[str]:
    return frozenset(_charmap())


def draw_icon(painter: QPainter, rect: QRectF, name: str, color: QColor | str) -> None:
    """Draw the icon ``name`` centred in ``rect``; nothing if the font is missing."""
    family, code = _family(), _charmap().get(name)
    if family is None or code is None:
        return
    painter.save()
    painter.setFont(_font(family, max(1, round(min(rect.width(), rect.height())))))
    painter.setPen(QColor(color))
    painter.drawText(rect.translated(QPointF(0, 0)), Qt.AlignmentFlag.AlignCenter, chr(int(code, 16)))
    painter.restore()


def icon(name: str, color: QColor | str, size_px: int = 18) -> QIcon:
    made = QIcon()
    for ratio in (1, 2):
        pixmap = QPixmap(ratio * size_px, ratio * size_px)
        pixmap.setDevicePixelRatio(ratio)
        pixmap.fill(Qt.GlobalColor.transparent)
        painter = QPainter(pixmap)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        draw_icon(painter, QRectF(0, 0, size_px, size_px), name, color)
        painter.end()
        made.addPixmap(pixmap)
    return made
