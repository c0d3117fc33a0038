"""What each process of this program is called in a system monitor, which would otherwise show a row of Pythons."""

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
    """Call this process after what it does; ``name`` is what it is called in the log or the command that began it."""
    setproctitle(f"caris: {title_of(name)}")


def title_of(name: str) -> str:
    """What it does, in a word or two."""
    return _DOES.get(name, name)
