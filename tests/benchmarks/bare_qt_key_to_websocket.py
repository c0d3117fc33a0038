"""Lower bound of teleoperation latency: a bare window whose key handler writes to a websocket.

``python -m tests.benchmarks.bare_qt_key_to_websocket ADDRESS`` presses a key in its own window for each line on
standard input. Each message carries the monotonic time of its key press, from which the receiver computes the latency.
"""

import json
import os
import signal
import sys
import time

from PySide6.QtCore import QSocketNotifier, Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QWidget
from websockets.sync.client import ClientConnection, connect

TOPIC = "/benchmark/floor"


class BareWindow(QWidget):
    def __init__(self, socket: ClientConnection) -> None:
        super().__init__()
        self._socket = socket
        self._pressed_ns = 0

    def press(self) -> None:
        self._pressed_ns = time.monotonic_ns()
        QTest.keyClick(self, Qt.Key.Key_W)

    def keyPressEvent(self, _event: QKeyEvent) -> None:
        message = {"op": "publish", "topic": TOPIC, "msg": {"data": str(self._pressed_ns)}}
        self._socket.send(json.dumps(message))


def main(address: str) -> None:
    application = QApplication(sys.argv[:1])
    signal.signal(signal.SIGTERM, lambda *_: application.quit())
    with connect(address, compression=None) as socket:
        socket.send(json.dumps({"op": "advertise", "topic": TOPIC, "type": "std_msgs/String"}))
        window = BareWindow(socket)
        window.show()
        asked = QSocketNotifier(sys.stdin.fileno(), QSocketNotifier.Type.Read)

        def press() -> None:
            if os.read(sys.stdin.fileno(), 4096):
                window.press()
            else:
                application.quit()

        asked.activated.connect(press)
        print("ready", flush=True)
        application.exec()


if __name__ == "__main__":
    main(sys.argv[1])
