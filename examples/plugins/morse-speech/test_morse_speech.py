"""The voice and the recogniser keep the contract of the program, and understand each other."""

import numpy as np
from caris_morse_speech import Morse

from caris_desktop.app.plugin_contracts import check_speech


def test_it_keeps_the_contract():
    sound = Morse(language="en").speak("Hello world.", rate=1.0, volume=1.0).astype(np.float32) / 32768
    check_speech(Morse, [(sound, "Hello world.")])
    assert [word for word, _, _ in Morse(language="en").transcribe(sound, before="")] == ["hello", "world"]
