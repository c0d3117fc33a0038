"""The pictures of people that panels show: fetched by key, so that no signal has to carry them."""

import threading
from collections import OrderedDict

MOST_KEPT = 200


class Portraits:
    """A bounded cache of JPEG by key. Any thread."""

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
        """The picture of ``PersonRow.portrait``; None where there is none any more."""
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
            return self._kept.get(key)

    def drop(self, key: str) -> None:
        with self._lock:
            self._kept.pop(key, None)

    def drop_all_of(self, person_id: str) -> None:
        """Every picture whose key begins with that id."""
        with self._lock:
            for key in [key for key in self._kept if key.startswith(f"{person_id}/")]:
                del self._kept[key]

    def __len__(self) -> int:
        return len(self._kept)
