"""Process titles for system monitors, in place of the name of Python."""

from setproctitle import setproctitle

_DOES = {
    "simulate": "simulated robot",
    "control": "driving and sensors",
    "media": "pictures and maps",
    "inference": "people detection",
    "recorder": "recording",
    "language-model": "language model",
    "camera-server": "camera server",
    "overview": "coding overview",
}


def title_process(name: str) -> None:
    """Set this process's title; ``name`` is its name in the log or its command."""
    setproctitle(f"caris: {title_of(name)}")


def title_of(name: str) -> str:
    """Its purpose in a word or two."""
    return _DOES.get(name, name)
