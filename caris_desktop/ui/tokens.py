"""Design tokens: colours, sizes and fonts of the window. The only file with colours."""

from caris_desktop.domain.value_class import Value

GRID_PX = 8
PANEL_RADIUS_PX = 10
CONTROL_RADIUS_PX = 8
CONTROL_HEIGHT_PX = 34

BODY_PX = 15
STATUS_PX = 13
SPEECH_PX = 18
GLANCE_PX, GLANCE_ICON_PX = 23, 28
"""Legible from two metres at 0.28 mm per pixel: the largest size that fits the strip below the top bar."""

KEY_CAP_PX = 12

WEIGHT_NORMAL = 400
WEIGHT_MEDIUM = 500
WEIGHT_SEMIBOLD = 600


class Colors(Value):
    """Colours of one theme. ``on_*`` is text on that colour; ``*_soft`` a tinted background for ordinary text."""

    name: str
    window: str
    panel: str
    raised: str
    raised_hover: str
    field: str
    line: str
    line_strong: str
    text: str
    dim: str
    blue: str
    blue_soft: str
    green: str
    green_soft: str
    amber: str
    amber_soft: str
    red: str
    red_fill: str
    red_hover: str
    red_soft: str
    on_blue: str
    on_red: str
    key_ground: str
    key_line: str
    video_ground: str
    video_text: str
    video_dim: str
    video_chip: str
    video_line: str
    box_named: str
    box_unnamed: str
    box_warning: str
    on_box: str
    map_free: str
    map_unknown: str
    map_wall: str
    lidar: str
    shadow: str
    coders: tuple[str, ...]
    """One per annotation coder, in rotation; labels on them use ``panel``."""


DARK = Colors(
    name="dark",
    window="#14171c",
    panel="#1b1f26",
    raised="#273040",
    raised_hover="#323d51",
    field="#14171c",
    line="#2c333f",
    line_strong="#414b5c",
    text="#e6e9ee",
    dim="#98a2b3",
    blue="#4c9df3",
    blue_soft="#1a2d45",
    green="#3fb984",
    green_soft="#173328",
    amber="#e6a23c",
    amber_soft="#3a2c14",
    red="#ff7378",
    red_fill="#d7373d",
    red_hover="#c12e34",
    red_soft="#42191c",
    on_blue="#0b1a2b",
    on_red="#ffffff",
    key_ground="#14171c",
    key_line="#465164",
    video_ground="#0c0e11",
    video_text="#f2f4f7",
    video_dim="#a7b0bf",
    video_chip="#d0101318",
    video_line="#2effffff",
    box_named="#3fb984",
    box_unnamed="#7db8f7",
    box_warning="#f0b45a",
    on_box="#071019",
    map_free="#2b3340",
    map_unknown="#101317",
    map_wall="#8494ad",
    lidar="#b48cf2",
    shadow="#70000000",
    coders=("#4cc2c4", "#b39bf8", "#eb9b66", "#ea86bf", "#a9c85c", "#7fb2f9"),
)

LIGHT = Colors(
    name="light",
    window="#eef1f5",
    panel="#ffffff",
    raised="#f1f4f8",
    raised_hover="#e4e9f0",
    field="#ffffff",
    line="#d5dbe4",
    line_strong="#b4bdca",
    text="#1a2230",
    dim="#5d6a7d",
    blue="#1f6fd1",
    blue_soft="#f0f6fe",
    green="#147a4f",
    green_soft="#e0f3ea",
    amber="#915700",
    amber_soft="#fdf1da",
    red="#c72c33",
    red_fill="#d3343a",
    red_hover="#b9282e",
    red_soft="#fce8e9",
    on_blue="#ffffff",
    on_red="#ffffff",
    key_ground="#ffffff",
    key_line="#b4bdca",
    video_ground="#1c222b",
    video_text="#f2f4f7",
    video_dim="#b6bfcc",
    video_chip="#d0101318",
    video_line="#2effffff",
    box_named="#3fb984",
    box_unnamed="#7db8f7",
    box_warning="#f0b45a",
    on_box="#071019",
    map_free="#ffffff",
    map_unknown="#d3dae4",
    map_wall="#4a586c",
    lidar="#7a3fd1",
    shadow="#38243447",
    coders=("#0e7680", "#6a4cd0", "#a94e14", "#b02f7a", "#55720f", "#2360c2"),
)
