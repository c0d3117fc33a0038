"""Speech on this computer: the process body that queues, renders and plays utterances."""

from multiprocessing.connection import Connection

from caris_desktop.conversation.speech_messages import SpeechSettings


def run_speech(connection: Connection, settings: SpeechSettings) -> None:
    """Process body: speak what is asked until the connection ends."""
    raise NotImplementedError
