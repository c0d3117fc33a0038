"""Sample people of a study: present, possibly recognised, departed, and many known ones."""

import io
import math

import numpy as np
from PIL import Image

from caris_desktop.domain import clock
from caris_desktop.people.presence import PersonRow, Suggestion
from tests.ui.fake_console import FakeConsole

MINUTE_NS = 60_000_000_000


def portrait(shade: int) -> bytes:
    """JPEG of one colour."""
    picture = np.full((160, 80, 3), (shade, 90, 200 - shade), np.uint8)
    held = io.BytesIO()
    Image.fromarray(picture).save(held, "JPEG")
    return held.getvalue()


def people_of_a_tour(now_ns: int = 0) -> tuple[PersonRow, ...]:
    now_ns = now_ns or clock.now_ns()
    return (
        PersonRow(
            "p-luis", 1, "Luis", True, now_ns - 3 * MINUTE_NS, now_ns, number=1, known=True, group="Group 1",
            tags=("asks a lot",), visit_id="p-1", confidence=0.943, distance_m=1.9, bearing_rad=0.3,
            speaking=True, posture="standing",
        ),
        PersonRow(
            "p-ana", 2, "Ana Torres", True, now_ns - 2 * MINUTE_NS, now_ns, number=2, known=True, group="Group 1",
            distance_m=2.4, bearing_rad=-0.02, hand_raised=True,
        ),
        PersonRow(
            "p-3", 4, "Person 3", True, now_ns - 12_000_000_000, now_ns, number=3, distance_m=3.26,
            bearing_rad=-0.4,
            suggestions=(Suggestion("p-mara", "Mara Silva", 0.824), Suggestion("p-k3", "Guest 003", 0.11)),
        ),
        PersonRow("p-4", 5, "Person 4", True, now_ns - 2_000_000_000, now_ns, number=4, posture="sitting"),
        PersonRow("p-5", 3, "Person 5", False, now_ns - 9 * MINUTE_NS, now_ns - 2 * MINUTE_NS, number=5),
        PersonRow("p-mara", 0, "Mara Silva", False, 0, 0, known=True, group="Group 2", tags=("shy", "wheelchair")),
        *(
            PersonRow(f"p-k{number}", 0, f"Guest {number:03}", False, 0, 0, known=True, group=f"Group {number % 4}")
            for number in range(20)
        ),
    )  # fmt: skip


def show_people(console: FakeConsole, rows: tuple[PersonRow, ...]) -> None:
    """Set the state as the console does: present people separately from all."""
    console.state.everybody.set(rows)
    console.state.persons.set(tuple(row for row in rows if row.here))


def many(count: int) -> tuple[PersonRow, ...]:
    """One present person, and ``count`` known ones."""
    now_ns = clock.now_ns()
    return (
        PersonRow("p-here", 1, "Luis", True, now_ns, now_ns, number=1, known=True, bearing_rad=math.pi / 3),
        *(PersonRow(f"p-k{number}", 0, f"Guest {number:03}", False, 0, 0, known=True) for number in range(count)),
    )
