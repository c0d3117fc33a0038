"""Person sprites for the camera: cut out of ultralytics' photos once, and cached per user."""

import importlib.util
import io
import logging
from pathlib import Path

import cv2
import numpy as np
import platformdirs
from numpy.typing import NDArray

from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.value_class import dataclass

logger = logging.getLogger(__name__)

Image = NDArray[np.uint8]
_VERSION = 1
_HEIGHT_PX = 640
_CACHE_NAME = f"people-v{_VERSION}.npz"


@dataclass(frozen=True, slots=True)
class _Source:
    """Person in the photo: rough outline in pixels, and modifications for further people."""

    outline: tuple[tuple[int, int], ...]
    mirrored: bool = False
    coat_bgr: tuple[float, float, float] | None = None


_PHOTO = "bus.jpg"
_MAN_IN_PALE_COAT = (
    (114, 404),
    (138, 398),
    (156, 410),
    (159, 431),
    (156, 451),
    (150, 468),
    (175, 494),
    (182, 510),
    (183, 530),
    (199, 553),
    (200, 577),
    (193, 589),
    (180, 600),
    (187, 632),
    (193, 689),
    (181, 691),
    (180, 699),
    (183, 726),
    (187, 758),
    (193, 790),
    (199, 821),
    (202, 852),
    (213, 866),
    (235, 876),
    (245, 882),
    (240, 888),
    (209, 897),
    (177, 898),
    (177, 862),
    (173, 852),
    (166, 821),
    (156, 786),
    (146, 746),
    (134, 715),
    (126, 703),
    (118, 715),
    (112, 742),
    (107, 766),
    (97, 790),
    (91, 817),
    (85, 848),
    (93, 864),
    (106, 884),
    (107, 896),
    (97, 900),
    (71, 894),
    (51, 886),
    (53, 868),
    (59, 858),
    (59, 848),
    (67, 812),
    (77, 796),
    (81, 775),
    (73, 734),
    (73, 701),
    (59, 697),
    (61, 656),
    (63, 616),
    (59, 565),
    (62, 530),
    (61, 498),
    (71, 484),
    (95, 470),
    (99, 451),
    (105, 439),
    (105, 419),
)
_MAN_IN_DARK_COAT = (
    (264, 427),
    (272, 414),
    (288, 408),
    (301, 414),
    (304, 427),
    (309, 443),
    (304, 459),
    (301, 474),
    (321, 483),
    (335, 494),
    (337, 518),
    (344, 541),
    (341, 559),
    (331, 566),
    (321, 569),
    (327, 608),
    (333, 648),
    (338, 681),
    (337, 695),
    (340, 711),
    (335, 722),
    (319, 742),
    (299, 762),
    (285, 778),
    (292, 793),
    (300, 813),
    (296, 820),
    (282, 813),
    (280, 821),
    (292, 845),
    (292, 856),
    (280, 859),
    (256, 852),
    (258, 829),
    (254, 805),
    (248, 774),
    (244, 734),
    (243, 705),
    (225, 699),
    (233, 636),
    (238, 593),
    (235, 565),
    (236, 530),
    (240, 510),
    (246, 494),
    (272, 480),
    (278, 467),
    (268, 455),
)
_SOURCES = (
    _Source(_MAN_IN_PALE_COAT),
    _Source(_MAN_IN_DARK_COAT),
    _Source(_MAN_IN_PALE_COAT, mirrored=True, coat_bgr=(0.75, 0.5, 0.36)),
)
_OUTLINE_ERROR_PX = 5


class PhotosMissing(Exception):  # noqa: N818 - a state of the installation, not a fault of the program
    """The source photos are not installed."""


def load_cut_outs(cache_folder: Path | None = None) -> list[Image]:
    """One sprite per person: BGRA with premultiplied alpha, uint8, shape (640, width, 4).

    Raises
    ------
    PhotosMissing
        When ultralytics, which brings the photos, is not installed.
    """
    folder = cache_folder or platformdirs.user_cache_path("caris-desktop", appauthor=False)
    cached = folder / _CACHE_NAME
    try:
        with np.load(cached, allow_pickle=False) as stored:
            pictures = [stored[str(index)] for index in range(len(_SOURCES))]
        if all(picture.ndim == 3 and picture.shape[0] == _HEIGHT_PX for picture in pictures):
            return pictures
    except FileNotFoundError:
        pass
    except (OSError, ValueError, KeyError, EOFError) as error:
        logger.warning("The cut-outs in %s are unreadable (%s) and made anew", cached, error)
    photo = _photo()
    pictures = [_cut_out(photo, source) for source in _SOURCES]
    _store(cached, pictures)
    return pictures


def levels_of(cut_out: Image) -> list[Image]:
    """Image pyramid: full size, half, a quarter ..., against aliasing of distant people."""
    levels = [cut_out]
    while levels[-1].shape[0] > 50:
        height, width = levels[-1].shape[:2]
        levels.append(np.asarray(cv2.resize(levels[-1], (width // 2, height // 2), interpolation=cv2.INTER_AREA)))
    return levels


def _photo() -> Image:
    found = importlib.util.find_spec("ultralytics")
    folders = list(found.submodule_search_locations or []) if found is not None else []
    for folder in folders:
        photo = cv2.imread(str(Path(folder) / "assets" / _PHOTO))
        if photo is not None:
            return np.asarray(photo, dtype=np.uint8)
    raise PhotosMissing(f"The package 'ultralytics' with its photo {_PHOTO} is not installed")


def _store(path: Path, pictures: list[Image]) -> None:
    content = io.BytesIO()
    np.savez_compressed(content, allow_pickle=False, **dict(zip("0123456789", pictures, strict=False)))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, content.getvalue(), durable=False)
    except OSError as error:
        logger.warning("The cut-outs cannot be kept in %s (%s); they are made anew every time", path.parent, error)


def _cut_out(photo: Image, source: _Source) -> Image:
    outline = np.array(source.outline, dtype=np.int32)
    margin = 30
    left, top = np.maximum(outline.min(axis=0) - margin, 0).tolist()
    right, bottom = (outline.max(axis=0) + margin).tolist()
    region = photo[top:bottom, left:right].copy()
    drawn = np.zeros(region.shape[:2], dtype=np.uint8)
    cv2.fillPoly(drawn, [outline - (left, top)], 1)
    # the outline was traced by eye: GrabCut refines its surroundings
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _OUTLINE_ERROR_PX + 1, 2 * _OUTLINE_ERROR_PX + 1))
    mask = np.where(drawn == 1, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    mask[cv2.erode(drawn, disc) == 1] = cv2.GC_FGD
    mask[cv2.dilate(drawn, disc) == 0] = cv2.GC_BGD
    cv2.setRNGSeed(1)
    cv2.grabCut(region, mask, None, np.zeros((1, 65)), np.zeros((1, 65)), 3, cv2.GC_INIT_WITH_MASK)
    inside = ((mask == cv2.GC_FGD) | (mask == cv2.GC_PR_FGD)).astype(np.uint8)
    inside = _largest_piece(cv2.morphologyEx(inside, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)))
    rows, columns = np.nonzero(inside)
    area = (slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1))
    person, alpha = region[area], inside[area] * 255
    # soft edge, moved inwards, so that no rim of the street is visible
    alpha = cv2.GaussianBlur(cv2.erode(alpha, np.ones((3, 3), np.uint8)), (0, 0), 1.0)
    if source.coat_bgr is not None:
        person = _recoloured(person, source.coat_bgr)
    scale = _HEIGHT_PX / person.shape[0]
    size = (round(person.shape[1] * scale), _HEIGHT_PX)
    person = cv2.resize(person, size, interpolation=cv2.INTER_CUBIC)
    alpha = cv2.resize(alpha, size, interpolation=cv2.INTER_LINEAR)
    if source.mirrored:
        person, alpha = person[:, ::-1], alpha[:, ::-1]
    weighted = person.astype(np.float32) * (alpha.astype(np.float32) / 255.0)[:, :, None]
    return np.dstack([np.round(weighted), alpha]).astype(np.uint8)


def _largest_piece(mask: Image) -> Image:
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    outline, _ = cv2.findContours((labels == largest).astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    filled = np.zeros_like(mask)
    cv2.drawContours(filled, outline, -1, 1, cv2.FILLED)
    return np.asarray(filled & (labels == largest), dtype=np.uint8)


def _recoloured(person: Image, gains_bgr: tuple[float, float, float]) -> Image:
    """Change the colour of the pale coat; face, hands, jeans and shoes stay."""
    hue, saturation, value = cv2.split(cv2.cvtColor(person, cv2.COLOR_BGR2HSV))
    pale = ((saturation < 115) & (value > 70) & (hue > 8)).astype(np.uint8)
    height = person.shape[0]
    pale[int(height * 0.61) :] = 0
    pale[: int(height * 0.15)] = 0
    pale = cv2.morphologyEx(pale, cv2.MORPH_CLOSE, np.ones((21, 21), np.uint8))
    share = cv2.GaussianBlur(pale.astype(np.float32), (0, 0), 1.2)[:, :, None]
    coloured = person.astype(np.float32) * np.array(gains_bgr, dtype=np.float32)
    mixed = person * (1.0 - share) + coloured * share
    return np.asarray(np.clip(mixed, 0, 255), dtype=np.uint8)
