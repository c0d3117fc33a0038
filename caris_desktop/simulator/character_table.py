"""Characters: twenty synthetic people, with their build and two sets of clothes each."""

from typing import Literal

from caris_desktop.domain.value_class import dataclass

Hair = Literal["short", "long", "bun", "bald", "curls"]
Pattern = Literal["plain", "stripes", "checks", "halves", "print", "dots"]
Top = Literal["shirt", "jumper", "open jacket", "long coat", "vest", "hooded"]
Lower = Literal["trousers", "wide trousers", "skirt", "long skirt", "shorts", "dress"]
Bag = Literal["", "backpack", "shoulder bag"]
Headwear = Literal["", "cap", "beanie", "scarf"]


@dataclass(frozen=True, slots=True)
class Clothes:
    """Set of clothes. Colours are written as ``#rrggbb``; ``second`` is that of the pattern or of the layer beneath."""

    top: Top
    colour: str
    second: str
    lower: Lower
    lower_colour: str
    shoes: str
    pattern: Pattern = "plain"
    bag: Bag = ""
    bag_colour: str = "#303030"
    headwear: Headwear = ""
    headwear_colour: str = "#202020"


@dataclass(frozen=True, slots=True)
class Character:
    """Constant features of a person. ``build``: relative width, 1 is normal."""

    height_m: float
    build: float
    skin: str
    hair: Hair
    hair_colour: str
    clothes: tuple[Clothes, Clothes]
    beard: bool = False


PALE, LIGHT, OLIVE, TAN, BROWN, DARK = "#edc5ab", "#dfae8e", "#c99a72", "#a9744f", "#7d5238", "#54372a"
BLACK, UMBER, CHESTNUT, BLOND, GREY, RED = "#1b1715", "#3a281d", "#5e3d26", "#c2a063", "#a5a3a0", "#8b3f1e"

CHARACTERS = (
    Character(
        1.82,
        1.0,
        PALE,
        "short",
        BLOND,
        (
            Clothes("open jacket", "#1d3f8c", "#e8e6df", "trousers", "#2a2d33", "#5b3a22"),
            Clothes("jumper", "#b08a2c", "#b08a2c", "shorts", "#55603d", "#e0e0e0", headwear="cap"),
        ),
    ),
    Character(
        1.66,
        0.92,
        LIGHT,
        "long",
        UMBER,
        (
            Clothes("shirt", "#b3202c", "#b3202c", "skirt", "#1c1c22", "#1c1c22"),
            Clothes("long coat", "#c9b38c", "#f2f2ee", "trousers", "#30425f", "#6b4a30"),
        ),
    ),
    Character(
        1.74,
        1.22,
        OLIVE,
        "short",
        BLACK,
        (
            Clothes("hooded", "#2f6b3a", "#d8d8d0", "wide trousers", "#4d5560", "#e8e8e8", bag="backpack"),
            Clothes("shirt", "#dedede", "#2b4f9e", "trousers", "#191c26", "#111111", pattern="stripes"),
        ),
        beard=True,
    ),
    Character(
        1.70,
        1.0,
        DARK,
        "curls",
        BLACK,
        (
            Clothes("shirt", "#e6b81e", "#e6b81e", "trousers", "#3b5f9b", "#e8e8e8"),
            Clothes("long coat", "#5a1f3d", "#1a1a1a", "trousers", "#1e1e22", "#3a2418"),
        ),
    ),
    Character(
        1.60,
        0.98,
        PALE,
        "bun",
        GREY,
        (
            Clothes("jumper", "#8e63a8", "#8e63a8", "long skirt", "#6a6f7a", "#2b2b2b", bag="shoulder bag"),
            Clothes("open jacket", "#2d7d83", "#f0e9d8", "trousers", "#b9a98c", "#7a5a3d"),
        ),
    ),
    Character(
        1.86,
        1.12,
        TAN,
        "bald",
        BLACK,
        (
            Clothes("shirt", "#f0f0ec", "#f0f0ec", "trousers", "#16223f", "#111111"),
            Clothes("hooded", "#8c1f24", "#8c1f24", "trousers", "#6d7279", "#d9d9d9", bag="backpack"),
        ),
        beard=True,
    ),
    Character(
        1.68,
        0.9,
        LIGHT,
        "long",
        RED,
        (
            Clothes("shirt", "#2a8f8a", "#f2efe6", "dress", "#2a8f8a", "#8a5a36", pattern="dots"),
            Clothes("jumper", "#e3dccb", "#6d4b8f", "trousers", "#23262d", "#23262d", pattern="halves"),
        ),
    ),
    Character(
        1.77,
        1.0,
        BROWN,
        "short",
        BLACK,
        (
            Clothes("shirt", "#b24a1e", "#e8d9b0", "trousers", "#8b7a5c", "#4a3020", pattern="checks"),
            Clothes("vest", "#20242c", "#7fa3c9", "trousers", "#3c4149", "#0f0f0f"),
        ),
    ),
    Character(
        1.72,
        1.28,
        PALE,
        "short",
        GREY,
        (
            Clothes("open jacket", "#6d6f72", "#9c2832", "trousers", "#4f4536", "#32261c"),
            Clothes("shirt", "#9fc3e3", "#9fc3e3", "wide trousers", "#c3b79a", "#8a6a4a"),
        ),
    ),
    Character(
        1.63,
        0.9,
        OLIVE,
        "long",
        BLACK,
        (
            Clothes(
                "long coat",
                "#17181c",
                "#c8c8c8",
                "trousers",
                "#17181c",
                "#7a1f1f",
                headwear="scarf",
                headwear_colour="#a23b57",
            ),
            Clothes(
                "shirt",
                "#e48a2a",
                "#e48a2a",
                "skirt",
                "#6b4a2b",
                "#3b2a1d",
                headwear="scarf",
                headwear_colour="#efe7d5",
            ),
        ),
    ),
    Character(
        1.79,
        0.94,
        LIGHT,
        "curls",
        CHESTNUT,
        (
            Clothes(
                "vest",
                "#d8571f",
                "#262a30",
                "trousers",
                "#6b7a86",
                "#2b2b2b",
                headwear="beanie",
                headwear_colour="#2b2f36",
            ),
            Clothes("jumper", "#26466b", "#e6e6e6", "shorts", "#b8a27a", "#f0f0f0", pattern="stripes"),
        ),
    ),
    Character(
        1.58,
        1.08,
        BROWN,
        "bun",
        BLACK,
        (
            Clothes("shirt", "#d96aa0", "#d96aa0", "wide trousers", "#f0eee8", "#c9b089"),
            Clothes("open jacket", "#3b5a2a", "#d9c06a", "long skirt", "#43301f", "#2b1f16"),
        ),
    ),
    Character(
        1.90,
        0.96,
        PALE,
        "short",
        UMBER,
        (
            Clothes("shirt", "#1f1f23", "#d8d8d8", "shorts", "#a39a83", "#f2f2f2", pattern="print"),
            Clothes("long coat", "#5f6e86", "#222222", "trousers", "#2c2c30", "#4a2f1d"),
        ),
        beard=True,
    ),
    Character(
        1.75,
        1.05,
        DARK,
        "short",
        BLACK,
        (
            Clothes("jumper", "#5fb0dd", "#f4f4f4", "trousers", "#e2ddcf", "#8a5c34", pattern="halves"),
            Clothes("shirt", "#3d2a63", "#3d2a63", "trousers", "#5a5f52", "#1f1f1f", bag="shoulder bag"),
        ),
    ),
    Character(
        1.65,
        0.95,
        TAN,
        "long",
        CHESTNUT,
        (
            Clothes("jumper", "#e9e3d4", "#8f2f2f", "trousers", "#7b2530", "#3a2018", pattern="stripes"),
            Clothes("shirt", "#3f7f4f", "#3f7f4f", "dress", "#3f7f4f", "#d8c8a8"),
        ),
    ),
    Character(
        1.71,
        1.15,
        LIGHT,
        "bald",
        GREY,
        (
            Clothes(
                "jumper",
                "#7a1f2b",
                "#7a1f2b",
                "trousers",
                "#8d8f94",
                "#23180f",
                bag="shoulder bag",
                bag_colour="#b5864f",
            ),
            Clothes("open jacket", "#b9c2c9", "#31547f", "trousers", "#3a4a33", "#5e5e5e"),
        ),
        beard=True,
    ),
    Character(
        1.62,
        0.88,
        PALE,
        "short",
        BLACK,
        (
            Clothes(
                "hooded", "#f0c3cd", "#f0c3cd", "shorts", "#4a76b8", "#f4f4f4", bag="backpack", bag_colour="#7d3fa0"
            ),
            Clothes("vest", "#3e8f5c", "#f2e4c2", "trousers", "#14161b", "#e8e8e8"),
        ),
    ),
    Character(
        1.80,
        1.1,
        OLIVE,
        "long",
        GREY,
        (
            Clothes(
                "long coat",
                "#6a4a2b",
                "#d9d2bf",
                "trousers",
                "#3f4c5e",
                "#1f1712",
                headwear="cap",
                headwear_colour="#5a4630",
            ),
            Clothes("shirt", "#c7d65a", "#c7d65a", "trousers", "#75685a", "#d0d0d0"),
        ),
        beard=True,
    ),
    Character(
        1.69,
        1.0,
        TAN,
        "bun",
        UMBER,
        (
            Clothes("shirt", "#3556c4", "#f4f4f4", "long skirt", "#c23b2e", "#2a2a2a", pattern="dots"),
            Clothes(
                "jumper",
                "#4a4d52",
                "#4a4d52",
                "wide trousers",
                "#7fa09a",
                "#efefef",
                bag="backpack",
                bag_colour="#c9552b",
            ),
        ),
    ),
    Character(
        1.76,
        0.93,
        BROWN,
        "curls",
        UMBER,
        (
            Clothes(
                "shirt",
                "#7fcf9a",
                "#2a2a2a",
                "trousers",
                "#57402d",
                "#e3e3e3",
                pattern="print",
                headwear="cap",
                headwear_colour="#d8d8d8",
            ),
            Clothes("hooded", "#2a2d35", "#d1462f", "shorts", "#2f5d8c", "#151515", pattern="halves"),
        ),
    ),
)
"""The people, by their number."""
