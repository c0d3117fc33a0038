"""Phosphor icons, drawn in any colour.

The glyphs come from qtawesome's font file; its Python code is not imported, which would delay the first window by 0.25
s.
"""

import json
import logging
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

from PySide6.QtCore import QPointF, QRectF, Qt
from PySide6.QtGui import QColor, QFont, QFontDatabase, QIcon, QPainter, QPixmap

logger = logging.getLogger(__name__)


@lru_cache(maxsize=1)
def _font_files() -> tuple[Path, Path] | None:
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
    pixmap = QPixmap(2 * size_px, 2 * size_px)
    pixmap.setDevicePixelRatio(2.0)
    pixmap.fill(Qt.GlobalColor.transparent)
    painter = QPainter(pixmap)
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    draw_icon(painter, QRectF(0, 0, size_px, size_px), name, color)
    painter.end()
    return QIcon(pixmap)
