"""The people of one study: opaque ids and names in a SQLite database."""

from dataclasses import dataclass
from pathlib import Path


class PeopleStoreError(Exception):
    """The study's people cannot be read or written; the text is a sentence for the wizard."""


@dataclass(frozen=True, slots=True)
class RegisteredPerson:
    """One row. Times are UTC nanoseconds; ``name`` is empty until the wizard gives one."""

    person_id: str
    number: int
    name: str
    created_utc_ns: int
    last_seen_utc_ns: int


class PeopleRegister:
    """Opens or creates the database at ``path``. Use from one thread. Raises PeopleStoreError."""

    def __init__(self, path: Path) -> None:
        self.path = path
