"""Progress bar of a command, on standard error."""

import sys
import time

_BAR_WIDTH = 30
_REPORT_EVERY_S = 0.2
_REPORT_LINES = 10


class ProgressBar:
    """Bar redrawn in a terminal; elsewhere ten lines."""

    def __init__(self, pictures_about: int, *, label: str = "") -> None:
        """``pictures_about`` is the estimated total, 0 if unknown; ``label`` is the label."""
        self._about = pictures_about
        self._label = f"{label} " if label else ""
        # The cursor control here is our own.
        self._out = getattr(sys.stderr, "plain", sys.stderr)
        self._drawn = self._out.isatty()
        self._began_s = time.perf_counter()
        self._reported_s = 0.0
        self._reported_tenths = 0

    def update(self, frames: int) -> None:
        now_s = time.perf_counter()
        if self._drawn:
            if now_s - self._reported_s >= _REPORT_EVERY_S:
                self._reported_s = now_s
                print(f"\r{self._words(frames)}", end="", file=self._out, flush=True)
            return
        tenths = min(_REPORT_LINES - 1, _REPORT_LINES * frames // self._about) if self._about else 0
        if tenths > self._reported_tenths:
            self._reported_tenths = tenths
            print(self._words(frames), file=self._out, flush=True)

    def end(self, frames: int) -> None:
        self._about = frames
        print(f"\r{self._words(frames)}" if self._drawn else self._words(frames), file=self._out, flush=True)

    def _words(self, frames: int) -> str:
        fps = frames / max(1e-9, time.perf_counter() - self._began_s)
        if not self._about:
            return f"{self._label}{frames} frames, {fps:.1f} per second"
        # The length stated in a file may be too small.
        part = min(1.0, frames / self._about)
        done = round(_BAR_WIDTH * part)
        bar = "#" * done + "." * (_BAR_WIDTH - done)
        return f"{self._label}[{bar}] {part:4.0%} {frames}/{max(frames, self._about)} frames, {fps:.1f} per second"
