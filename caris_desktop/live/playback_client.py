"""Playback process for streamed audio: started on demand, restarted when hung. GUI thread."""

from collections.abc import Callable
from typing import Any

from PySide6.QtCore import QObject, QTimer

from caris_desktop.conversation.sound.playback_messages import (
    BeginPlaying,
    EndPlaying,
    PlaybackAlive,
    PlaybackFailed,
    PlaybackStarted,
    PlayedOut,
    PlayThis,
    SetVolume,
)
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.translation import tr
from caris_desktop.live.child_process import ChildProcess, ProcessSpec
from caris_desktop.live.process_manager import ProcessManager
from caris_desktop.live.service import Restarts

_STUCK_AFTER_MS = 5000


class Playback(QObject):
    """Plays one stream at a time, identified by an id."""

    def __init__(
        self,
        body: ProcessSpec,
        children: ProcessManager,
        *,
        played: Callable[[PlaybackStarted], None] = lambda _played: None,
        ended: Callable[[str, int | None, str], None],
        parent: QObject,
    ) -> None:
        """``played`` receives what is audible, in another thread. ``ended(stream_id, heard_out_ns, detail)``: the
        stream has ended; ``heard_out_ns`` is None for a failure, explained by ``detail``.
        """
        super().__init__(parent)
        self._body = body
        self._children = children
        self._played = played
        self._ended = ended
        self.child: ChildProcess | None = None
        self._stream_id = ""
        self.restarts = Restarts()
        self._stuck = QTimer(self, singleShot=True, interval=_STUCK_AFTER_MS)
        self._stuck.timeout.connect(self._on_stuck)

    @property
    def process_name(self) -> str:
        return self._body.name

    def get_ready(self) -> None:
        """Start the process in advance, so that playback begins at once."""
        if self.child is None and not self.restarts.exhausted:
            self.child = self._children.start(
                self._body, ended=self._on_ended, heard=self.on_message, reads=self._read
            )  # fmt: skip

    def dismiss(self) -> None:
        """End the process: this scenario does not use it."""
        child, self.child = self.child, None
        if child is not None:
            self._stuck.stop()
            self._children.dismiss(child, grace_s=1.0)

    def begin(self, stream_id: str, *, volume: float = 1.0, most_s: float = 0.25) -> None:
        self.get_ready()
        self._stream_id = stream_id
        if self.child is None:
            self._give_up(tr("it failed too often"))
        else:
            self.child.send(BeginPlaying(stream_id, volume, most_s))

    def play(self, chunk: AudioChunk) -> None:
        """Play the next chunk, or drop it. Any thread."""
        child = self.child
        if child is not None:
            child.send(PlayThis(chunk.sample_rate_hz, chunk.samples))

    def set_volume(self, volume: float) -> None:
        if self.child is not None:
            self.child.send(SetVolume(volume))

    def end(self, *, at_once: bool = False) -> None:
        """End the stream; ``ended`` follows once everything was played."""
        if self._stream_id and self.child is not None:
            self._stuck.start()
            self.child.send(EndPlaying(at_once))

    def ask_to_end(self) -> None:
        self._stuck.stop()
        if self.child is not None:
            self.child.ask_to_end()

    def stop(self) -> None:
        if self.child is not None:
            self.child.stop(grace_s=1.0)

    def _read(self, value: Any, raw: bytes) -> None:  # reader thread
        if isinstance(value, PlaybackStarted):
            self._played(value)
        else:
            self._children.pass_on(self.on_message, value, raw)

    def on_message(self, message: Any) -> None:
        """Handle a message of the process."""
        match message:
            case PlayedOut(stream_id, stamp_ns) if stream_id == self._stream_id:
                self._stream_id = ""
                self._stuck.stop()
                self._ended(stream_id, stamp_ns, "")
            case PlaybackFailed(stream_id, detail) if stream_id == self._stream_id:
                self._give_up(detail)
            case PlaybackAlive():
                self._stuck.start()

    def _give_up(self, detail: str) -> None:
        self._stuck.stop()
        stream_id, self._stream_id = self._stream_id, ""
        if stream_id:
            self._ended(stream_id, None, detail)

    def _on_stuck(self) -> None:
        if self.child is not None and self._stream_id:
            self.child.kill()

    def _on_ended(self, child: ChildProcess) -> None:
        if child is not self.child:
            return
        self.child = None
        self.restarts.another()  # restarted at the next playback; reported by the owner of the stream
        self._give_up(tr("the sound system stopped responding"))
