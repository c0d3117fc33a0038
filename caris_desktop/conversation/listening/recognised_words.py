"""Recognised words: those of speech, and those that are stable, on which two successive recognition passes agree.

After LocalAgreement-2 (Liu et al. 2020; Macháček et al. 2023, "Turning Whisper into Real-Time Transcription System").
"""

import difflib
import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

from caris_desktop.domain.value_class import Value

_SENTENCE_END = (".", "?", "!", "。", "？", "！", "…")
_ALIGN_WORDS = 8
_SAME_TIME_S = 0.6
_NOT_SPOKEN = re.compile(r"[^\w']+")


class RecognisedWord(Value):
    """Recognised word without surrounding spaces; seconds from the start of the sound. ``probability`` is None if the
    engine does not provide it.
    """

    text: str
    start_s: float
    end_s: float
    probability: float | None = None

    @property
    def spoken(self) -> str:
        """Normalised form, for comparison."""
        return _NOT_SPOKEN.sub("", self.text.casefold())

    def later_by(self, seconds: float) -> "RecognisedWord":
        """Shift the times by ``seconds``."""
        return replace(self, start_s=self.start_s + seconds, end_s=self.end_s + seconds)


class AgreedWords:
    """Words of one turn. Committed words never change."""

    def __init__(self) -> None:
        self._committed: list[RecognisedWord] = []
        self._tentative: list[RecognisedWord] = []

    @property
    def committed(self) -> str:
        return " ".join(word.text for word in self._committed)

    @property
    def tentative(self) -> str:
        return " ".join(word.text for word in self._tentative)

    def texts_from(self, first: int) -> tuple[str, str]:
        """Committed and tentative text, without the words before ``first``."""
        behind = max(0, first - len(self._committed))
        committed, tentative = self._committed[first:], self._tentative[behind:]
        return " ".join(word.text for word in committed), " ".join(word.text for word in tentative)

    @property
    def words(self) -> tuple[RecognisedWord, ...]:
        """All words, committed and tentative."""
        return (*self._committed, *self._tentative)

    @property
    def committed_until_s(self) -> float:
        return self._committed[-1].end_s if self._committed else 0.0

    def add(self, recognised: Sequence[RecognisedWord]) -> None:
        """Add the result of another pass, from any start to the end of the sound so far."""
        new = list(recognised[self._already(recognised) :])
        agreed = 0
        for before, now in zip(self._tentative, new, strict=False):
            if before.spoken != now.spoken:
                break
            agreed += 1
        self._committed += new[:agreed]
        self._tentative = new[agreed:]

    def commit_all(self) -> None:
        """Commit all words: no further pass will change them."""
        self._committed += self._tentative
        self._tentative = []

    def cut_at_s(self, *, sentences: bool = True) -> float | None:
        """End of the last committed sentence, or word, before which sound is no longer needed; None
        if there is none.
        """
        ends = [word.end_s for word in self._committed if not sentences or word.text.endswith(_SENTENCE_END)]
        return ends[-1] if ends else None

    def _already(self, recognised: Sequence[RecognisedWord]) -> int:
        """Number of leading words that repeat committed ones."""
        if not self._committed:
            return 0
        # A pass may begin within the committed words, and recognise some of them differently.
        overlapping = [word for word in self._committed if not recognised or word.end_s > recognised[0].start_s - 0.1]
        last = [word.spoken for word in overlapping[-_ALIGN_WORDS:]]
        if last:
            spoken_words = [word.spoken for word in recognised]
            if spoken_words[: len(overlapping)] == [word.spoken for word in overlapping]:
                return len(overlapping)
            matcher = difflib.SequenceMatcher(None, last, spoken_words, autojunk=False)
            for block in reversed(matcher.get_matching_blocks()):
                at = block.b + block.size
                behind = len(last) - (block.a + block.size)
                if not block.size or at + behind > len(recognised):
                    continue
                known = overlapping[-behind - 1]
                # Times are inexact, above all after a pause; several words in a row rarely match by chance.
                if abs(recognised[at - 1].end_s - known.end_s) <= _SAME_TIME_S * block.size:
                    return at + behind
        until_s = self.committed_until_s
        return sum((word.start_s + word.end_s) / 2 <= until_s for word in recognised)


# Hallucination filter: text that recognisers, trained on subtitles, produce for sound without speech.

_NO_SPEECH = 0.6
_UNLIKELY = -1.0
_WORST = -1.6
_AFTER_VOICE_S = 0.15
_REPEATED_AT_MOST = 3
_LONG_PHRASE = 4
_WORDS_A_SECOND = 5.0
"""Nobody says the same phrase twice as fast as this."""
# Subtitle texts for music and silence in the training data, by language. People say some of them too.
_SUBTITLES: Mapping[str, tuple[str, ...]] = {
    "en": (
        "thank you", "thanks", "thank you very much", "thanks for watching", "thank you for watching", "bye",
        "bye bye", "you", "so", "okay", "oh", "please subscribe", "subscribe", "the end",
        "thank you so much for watching", "see you next time", "see you in the next video", "music", "applause",
        "silence", "i'll see you next time", "like and subscribe", "don't forget to subscribe",
    ),
    "de": (
        "vielen dank", "danke", "danke schön", "vielen dank fürs zuschauen", "danke fürs zuschauen", "tschüss",
        "musik", "bis zum nächsten mal", "das war's", "vielen dank für die aufmerksamkeit", "amen", "applaus",
        "das war's für heute", "vielen dank für ihre aufmerksamkeit", "bis dann",
    ),
    "fr": (
        "merci", "merci beaucoup", "merci d'avoir regardé", "merci d'avoir regardé cette vidéo", "au revoir",
        "musique", "abonnez vous", "à bientôt", "n'oubliez pas de vous abonner", "merci à tous",
    ),
    "es": (
        "gracias", "muchas gracias", "gracias por ver", "gracias por ver el video", "gracias por ver el vídeo",
        "adiós", "suscríbete", "suscríbete al canal", "hasta la próxima", "música", "chau", "aplausos",
    ),
    "it": (
        "grazie", "grazie mille", "grazie a tutti", "grazie per la visione", "grazie per aver guardato il video",
        "ciao", "iscrivetevi al canale", "alla prossima", "musica", "arrivederci",
    ),
    "pt": (
        "obrigado", "obrigada", "muito obrigado", "obrigado por assistir", "obrigado por assistirem", "tchau",
        "música", "inscreva se no canal", "até a próxima", "e aí",
    ),
    "nl": (
        "bedankt", "dank je wel", "dank u wel", "bedankt voor het kijken", "tot de volgende keer", "tot ziens",
        "muziek", "dankjewel", "doei",
    ),
    "pl": (
        "dziękuję", "dziękuję za uwagę", "dziękuję za oglądanie", "dzięki za oglądanie", "do zobaczenia", "muzyka",
    ),
    "cs": (
        "děkuji", "děkuju", "děkuji za pozornost", "na shledanou", "hudba",
    ),
    "sv": (
        "tack", "tack så mycket", "tack för att ni tittade", "tack för att du tittade", "hej då", "musik",
    ),
    "da": (
        "tak", "tak for at du så med", "tak fordi du så med", "farvel", "musik",
    ),
    "no": (
        "takk", "takk for at du så på", "takk for at dere så på", "ha det", "musikk",
    ),
    "fi": (
        "kiitos", "kiitos kun katsoit", "kiitos katsomisesta", "hei hei", "musiikkia",
    ),
    "hu": (
        "köszönöm", "köszönöm a figyelmet", "köszönöm hogy megnézted", "viszlát", "zene",
    ),
    "ro": (
        "mulțumesc", "vă mulțumesc", "mulțumesc pentru vizionare", "la revedere", "muzică",
    ),
    "el": (
        "ευχαριστώ", "ευχαριστώ πολύ", "ευχαριστώ που παρακολουθήσατε", "γεια σας", "μουσική",
    ),
    "tr": (
        "teşekkürler", "teşekkür ederim", "izlediğiniz için teşekkürler", "izlediğiniz için teşekkür ederim",
        "müzik", "abone olmayı unutmayın", "bir sonraki videoda görüşmek üzere",
    ),
    "ru": (
        "спасибо", "спасибо за просмотр", "спасибо за внимание", "до свидания", "продолжение следует", "музыка",
        "подписывайтесь на канал", "до новых встреч", "всем пока", "пока",
    ),
    "uk": (
        "дякую", "дякую за перегляд", "дякую за увагу", "до побачення", "музика", "підписуйтесь на канал",
    ),
    "ar": (
        "شكرا", "شكرا لكم", "شكرا للمشاهدة", "اشتركوا في القناة", "موسيقى",
    ),
    "he": (
        "תודה", "תודה רבה", "תודה שצפיתם", "להתראות", "מוזיקה",
    ),
    "hi": (
        "धन्यवाद", "शुक्रिया", "देखने के लिए धन्यवाद", "संगीत",
    ),
    "id": (
        "terima kasih", "terima kasih telah menonton", "sampai jumpa", "musik",
    ),
    "vi": (
        "cảm ơn", "cảm ơn các bạn đã theo dõi", "cảm ơn các bạn đã xem", "hẹn gặp lại",
        "hãy subscribe cho kênh ghiền mì gõ để không bỏ lỡ những video hấp dẫn",
    ),
    "zh": (
        "谢谢", "謝謝", "谢谢大家", "谢谢观看", "謝謝觀看", "感谢观看", "感謝觀看", "再见",
        "请不吝点赞 订阅 转发 打赏支持明镜与点点栏目", "請不吝點贊 訂閱 轉發 打賞支持明鏡與點點欄目", "音乐",
        "字幕",
    ),
    "ja": (
        "ありがとうございました", "ご視聴ありがとうございました", "ご視聴ありがとうございます",
        "チャンネル登録お願いします", "おやすみなさい", "ご清聴ありがとうございました",
        "最後までご視聴いただきありがとうございます", "音楽",
    ),
    "ko": (
        "감사합니다", "시청해주셔서 감사합니다", "시청해 주셔서 감사합니다", "구독과 좋아요 부탁드립니다",
        "다음 영상에서 만나요", "음악",
    ),
}  # fmt: skip
# Subtitle credits: nobody says these, whatever the recogniser's confidence.
_CREDITS = re.compile(
    "|".join(
        (
            r"amara\s?org", r"\bsubtitles (?:by|created)",
            r"\bunter\s?titel(?:ung)?\b.*\b(?:von|des|im auftrag|\d{4})\b",
            r"untertitel(?:ung)? (?:\w+ )?(?:zdf|ndr|swr)",
            r"\bsous\s?titr\w* (?:par|réalisés|fr|st)", r"\bsous\s?titrage",
            r"\bsubtítulos (?:por|realizados|de la)", r"\blegendas? (?:pela|por)",
            r"\bondertitel\w* (?:door|ingediend)",
            r"\bsottotitoli (?:creati|e revisione|a cura)", r"\bnapisy (?:stworzone|wykonane)",
            r"\btitulky (?:vytvořil|přeložil)", r"\bundertext\w* (?:av|från)",
            r"субтитры (?:сделал|создавал|делал|подогнал)", r"редактор субтитров", r"субтитрувальниця",
            r"altyazı m\s?k", r"字幕\s?(?:由|志愿者|志願者|製作|by)", r"자막\s?(?:제공|by)",
        )
    ),
    re.IGNORECASE,
)  # fmt: skip
_UNSURE_OF_SUBTITLE = 0.35
_SIGNS = re.compile(r"[^\w\s']+")
# Of these, what is said to viewers only.
_TO_VIEWERS = re.compile(
    r"watch|subscri|next video|zuschauen|regardé|abonne|ver el v|suscríb|visione|guardat|iscriv|assisti|inscreva|"
    r"kijken|oglądan|tittade|så (?:med|på)|kats|megnézt|vizionar|παρακολουθ|izle|abone|просмотр|подпис|перегляд|"
    r"підпис|مشاهدة|القناة|שצפית|देखने|menonton|theo dõi|đã xem|观看|觀看|订阅|訂閱|視聴|チャンネル|시청|구독|영상",
    re.IGNORECASE,
)
# Sounds, speaker labels, times and tokens: in brackets anywhere, in parentheses at the beginning or end of a sentence.
_NOT_WORDS = re.compile(
    r"\[[^\[\]]{0,200}\]:?|<\|[^<>|]{0,40}\|>|♪[^♪\n]{0,200}♪?|\*\w[^*\n]{0,200}\w\*|"
    r"(?:^|(?<=[.!?]))[ \t]{0,9}\([^()]{0,200}\)|\([^()]{0,200}\)[ \t]{0,9}$|^[ \t]{0,9}(?:>>|-)\s",
    re.MULTILINE,
)


def words_only(text: str) -> str:
    """``text`` of a recogniser without descriptions of sounds, speaker labels, times and tokens."""
    return _NOT_WORDS.sub(" ", _NOT_WORDS.sub(" ", text))


def is_nothing(text: str, *, no_speech: float | None, log_probability: float, language: str = "") -> bool:
    """True for text that a recogniser produces without speech. ``no_speech`` is None where the recogniser does not
    report it. ``language`` is that of the text, as in ``de`` or ``pt-BR``; without one, or for an unlisted one, all
    lists apply.
    """
    plain = _plain(words_only(text))
    if not plain or _CREDITS.search(plain):
        return True
    unsure = no_speech or 0.0
    if log_probability < _WORST or (unsure > _NO_SPEECH and log_probability < _UNLIKELY):
        return True
    to_viewers = no_speech is None and _TO_VIEWERS.search(plain) is not None
    return (to_viewers or unsure > _UNSURE_OF_SUBTITLE) and plain in _subtitles(language)


def _plain(text: str) -> str:
    # The one capital that becomes two letters, and the typographic apostrophe.
    text = unicodedata.normalize("NFC", text).replace("İ", "i").replace("’", "'")
    return " ".join(_SIGNS.sub(" ", text.casefold()).split())


# As servers of Whisper name the languages.
_CODES = {
    "english": "en", "german": "de", "french": "fr", "spanish": "es", "italian": "it", "portuguese": "pt",
    "dutch": "nl", "polish": "pl", "czech": "cs", "swedish": "sv", "danish": "da", "norwegian": "no", "finnish": "fi",
    "hungarian": "hu", "romanian": "ro", "greek": "el", "turkish": "tr", "russian": "ru", "ukrainian": "uk",
    "arabic": "ar", "hebrew": "he", "hindi": "hi", "indonesian": "id", "vietnamese": "vi", "chinese": "zh",
    "japanese": "ja", "korean": "ko",
}  # fmt: skip


def language_code(language: str) -> str:
    """Code, as ``de``, of a code with a region or of a name, as ``German``; other names in lower case."""
    name = language.replace("_", "-").partition("-")[0].strip().lower()
    return _CODES.get(name, name)


@cache
def _subtitles(language: str) -> frozenset[str]:
    """Phrases of a language and of English, which occurs in silence of any."""
    code = language_code(language)
    languages = ("en", code) if code in _SUBTITLES else tuple(_SUBTITLES)
    return frozenset(_plain(phrase) for each in languages for phrase in _SUBTITLES[each])


def within_voice(words: Sequence[RecognisedWord], voice_ended_s: float) -> list[RecognisedWord]:
    """Words that begin while there is voice: later ones were not said."""
    return [word for word in words if word.start_s < voice_ended_s + _AFTER_VOICE_S]


def without_repetition(words: Sequence[RecognisedWord]) -> list[RecognisedWord]:
    """Reduce repetitions of a stuck recogniser: a phrase of one to six words over and over, or twice in the time of
    one.

    People do repeat a word three times, and a question twice.
    """
    remaining = _without_repeats(list(words))
    for length in range(1, 7):
        at = 0
        while at + length <= len(remaining):
            phrase = [word.spoken for word in remaining[at : at + length]]
            times = 1
            while [word.spoken for word in remaining[at + times * length : at + (times + 1) * length]] == phrase:
                times += 1
            if times > _REPEATED_AT_MOST:
                del remaining[at + length : at + times * length]
            at += 1
    return remaining


def _without_repeats(words: list[RecognisedWord]) -> list[RecognisedWord]:
    for length in range(len(words) // 2, _LONG_PHRASE - 1, -1):
        for at in range(len(words) - 2 * length + 1):
            both = words[at : at + 2 * length]
            again = [word.spoken for word in both[:length]] == [word.spoken for word in both[length:]]
            if again and len(both) > _WORDS_A_SECOND * (both[-1].end_s - both[0].start_s):
                return words[: at + length] + words[at + 2 * length :]
    # The same for a second repetition that breaks off with the sound.
    for length in range(len(words) // 2, _LONG_PHRASE - 1, -1):
        tail = [word.spoken for word in words[-length:]]
        for at in range(len(words) - 2 * length + 1):
            both = words[at:]
            again = [word.spoken for word in both[:length]] == tail
            if again and len(both) > _WORDS_A_SECOND * (both[-1].end_s - both[0].start_s):
                return words[:-length]
    return words
