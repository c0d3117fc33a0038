"""The recorder: a process of its own, so that neither encoding nor a full disk holds up the console."""

from multiprocessing.connection import Connection

from caris_desktop.domain.ports import FrameReader


def run_recorder(connection: Connection, frames: FrameReader) -> None:
    """Process body. Records what ``connection`` brings until it ends; see ``recording.messages``.

    One process serves any number of sessions, one after the other. When the connection ends during a session, the
    session is closed with the reason ``console_closed``.
    """
    raise NotImplementedError
