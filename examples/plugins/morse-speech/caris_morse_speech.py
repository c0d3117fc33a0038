"""Voice and recogniser for CARIS Desktop that use Morse code: the same sound and words in each rehearsal."""

import numpy as np

SIGNS = """.- -... -.-. -.. . ..-. --. .... .. .--- -.- .-.. -- -. --- .--. --.- .-. ... - ..- ...- .-- -..- -.-- --..
----- .---- ..--- ...-- ....- ..... -.... --... ---.. ----."""
CODES = dict(zip("abcdefghijklmnopqrstuvwxyz0123456789", SIGNS.split(), strict=True))
LETTERS = {code: letter for letter, code in CODES.items()}
UNIT_S, PITCH_HZ, LOUD = 0.02, 700, 0.05


class Morse:
    """The contract is ``caris_desktop.conversation.speech_plugins.SpeechPlugin``."""

    caris_interface = 1
    rate_hz = 16_000

    def __init__(self, *, language):
        pass

    def speak(self, text, *, rate, volume):
        words = ["".join(letter for letter in word if letter in CODES) for word in text.lower().split()]
        coded = [" ".join(CODES[letter] for letter in word) for word in words if word]
        units = []
        for sign in " / ".join(coded) or " ":
            units += {".": [1, 0], "-": [1, 1, 1, 0], " ": [0, 0], "/": [0, 0]}[sign]
        key = np.repeat(units, round(UNIT_S * self.rate_hz / rate))
        tone = np.sin(2 * np.pi * PITCH_HZ * np.arange(len(key)) / self.rate_hz)
        return (20_000 * volume * key * tone).astype(np.int16)

    def transcribe(self, sound, *, before):
        """Words at the usual rate. A unit counts as on if it is loud in its middle."""
        unit = round(UNIT_S * self.rate_hz)
        begins = np.flatnonzero(np.abs(sound) > LOUD)
        if not begins.size:
            return []
        sound = sound[begins[0] :]
        units = np.abs(sound[: len(sound) // unit * unit]).reshape(-1, unit).max(axis=1) > LOUD
        # Runs of 1 and 3 units are dots and dashes; pauses of 3 and more end letters and words.
        signs = "".join("1" if on else "0" for on in units).strip("0").replace("111", "-").replace("1", ".")
        words, at_s = [], begins[0] / self.rate_hz
        for word in signs.split("0000000"):
            letters = (code.replace("0", "") for code in word.strip("0").split("000"))
            length_s = UNIT_S * sum({"-": 3}.get(sign, 1) for sign in word)
            text = "".join(LETTERS.get(code, "") for code in letters)
            words.append((text, at_s, at_s + length_s))
            at_s += length_s + 7 * UNIT_S
        return [word for word in words if word[0]]
