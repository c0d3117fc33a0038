"""Portrait cache for panels, by key, so that signals need not carry images."""

import threading
from collections import OrderedDict

MAX_PORTRAITS = 200


class Portraits:
    """Bounded cache of JPEGs by key. Any thread."""

    def __init__(self, at_most: int = MAX_PORTRAITS) -> None:
        self._at_most = at_most
        self._lock = threading.Lock()
        self._jpegs: OrderedDict[str, bytes] = OrderedDict()

    def put(self, key: str, jpeg: bytes) -> None:
        with self._lock:
            self._jpegs[key] = jpeg
            self._jpegs.move_to_end(key)
            while len(self._jpegs) > self._at_most:
                self._jpegs.popitem(last=False)

    def get(self, key: str) -> bytes | None:
        """Image of ``PersonRow.portrait``; None if it is no longer cached."""
        with self._lock:
            if key in self._jpegs:
                self._jpegs.move_to_end(key)
            return self._jpegs.get(key)

    def drop(self, key: str) -> None:
        with self._lock:
            self._jpegs.pop(key, None)

    def drop_all_of(self, person_id: str) -> None:
        """Drop all images whose key begins with that id."""
        with self._lock:
            for key in [key for key in self._jpegs if key.startswith(f"{person_id}/")]:
                del self._jpegs[key]

    def __len__(self) -> int:
        return len(self._jpegs)
