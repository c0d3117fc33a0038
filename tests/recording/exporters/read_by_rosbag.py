"""Reader of a bag with ROS 1, run by the system's Python: types and messages as JSON, by topic."""

import json
import sys
from typing import Any

import rosbag  # type: ignore[import-not-found]  # Debian's, not of this environment


def plain(value: Any) -> Any:
    if hasattr(value, "__slots__") and hasattr(value, "_type"):
        return {name: plain(getattr(value, name)) for name in value.__slots__}
    if hasattr(value, "to_nsec"):
        return value.to_nsec()
    if isinstance(value, bytes):
        return value.hex()
    return [plain(item) for item in value] if isinstance(value, (list, tuple)) else value


def main(path: str) -> None:
    topics: dict[str, dict[str, Any]] = {}
    with rosbag.Bag(path) as bag:
        compression = bag.get_compression_info().compression
        for connection in bag._get_connections():
            topics[connection.topic] = {"type": connection.datatype, "md5": connection.md5sum, "messages": []}
        for topic, message, at in bag.read_messages():
            told = topics[topic]
            # Computed from the definition in the bag; a compiled subscriber refuses any other sum.
            told["md5_of_definition"] = message._md5sum
            told["messages"].append([at.to_nsec(), plain(message)])
    json.dump({"compression": compression, "topics": topics}, sys.stdout)


main(sys.argv[1])
