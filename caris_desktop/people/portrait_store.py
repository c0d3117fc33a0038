"""Portrait cache for panels, by key, so that signals need not carry images."""

import threading
from collections import OrderedDict

MOST_KEPT = 200


class Portraits:
    """Bounded cache of JPEGs by key. Any thread."""

    def __init__(self, at_most: int = MOST_KEPT) -> None:
        self._at_most = at_most
        self._lock = threading.Lock()
        self._kept: OrderedDict[str, bytes] = OrderedDict()

    def put(self, key: str, jpeg: bytes) -> None:
        with self._lock:
            self._kept[key] = jpeg
            self._kept.move_to_end(key)
            while len(self._kept) > self._at_most:
                self._kept.popitem(last=False)

    def get(self, key: str) -> bytes | None:
        """Image of ``PersonRow.portrait``; None if it is no longer cached."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
            return self._kept.get(key)

    def drop(self, key: str) -> None:
        with self._lock:
            self._kept.pop(key, None)

    def drop_all_of(self, person_id: str) -> None:
        """Drop all images whose key begins with that id."""
        with self._lock:
            for key in [key for key in self._kept if key.startswith(f"{person_id}/")]:
                del self._kept[key]

    def __len__(self) -> int:
        return len(self._kept)
