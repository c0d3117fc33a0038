import pytest

from caris_desktop.conversation.listening.recognised_words import RecognisedWord, is_nothing, without_repetition

QUESTION = "Hello, can the robot arm hurt people when it moves?"


def _words(text: str, seconds: float) -> list[RecognisedWord]:
    spoken = text.split()
    each_s = seconds / len(spoken)
    return [RecognisedWord(word, number * each_s, (number + 1) * each_s) for number, word in enumerate(spoken)]


def _stored(text: str, seconds: float) -> str:
    return " ".join(word.text for word in without_repetition(_words(text, seconds)))


@pytest.mark.parametrize("again", [QUESTION, "Hello, can the robot arm hurt people when", "hello can the robot"])
def test_words_repeated_too_fast_count_once_also_where_they_break_off(again: str) -> None:
    assert _stored(f"{QUESTION} {again}", 2.7) == QUESTION


def test_a_question_asked_twice_is_transcribed_twice() -> None:
    assert _stored(f"{QUESTION} {QUESTION}", 6.0) == f"{QUESTION} {QUESTION}"
    assert _stored("No no no, not that one", 1.5) == "No no no, not that one"


@pytest.mark.parametrize(
    ("language", "text"),
    [
        ("en", "Thank you."), ("de", "Vielen Dank."), ("de-DE", "Bis zum nächsten Mal!"),
        ("fr", "Merci d’avoir regardé"),
        ("fr", "À bientôt."), ("es", "¡Gracias por ver el video!"), ("it", "Grazie a tutti."), ("pt_BR", "Obrigado."),
        ("nl", "Bedankt voor het kijken!"), ("pl", "Dziękuję za uwagę."), ("ru", "Спасибо за просмотр!"),
        ("uk", "Дякую за перегляд!"), ("tr", "İzlediğiniz için teşekkürler."), ("ar", "شكرا للمشاهدة"),
        ("hi", "देखने के लिए धन्यवाद"), ("zh", "謝謝觀看"), ("ja", "ご視聴ありがとうございました。"),
        ("ko", "시청해주셔서 감사합니다."),
        ("de", "Thank you."), ("", "Vielen Dank."), ("german", "Vielen Dank."), ("xx", "Merci."),
    ],
)  # fmt: skip
def test_subtitles_of_each_language_are_nothing_where_the_recogniser_is_unsure(language: str, text: str) -> None:
    assert is_nothing(text, no_speech=0.6, log_probability=-0.5, language=language)
    assert not is_nothing(text, no_speech=0.05, log_probability=-0.2, language=language), "people say it too"


def test_a_word_of_one_language_is_not_taken_for_a_subtitle_of_another() -> None:
    assert not is_nothing("Musik.", no_speech=0.6, log_probability=-0.5, language="en")
    assert not is_nothing("Doei", no_speech=0.6, log_probability=-0.5, language="de")


@pytest.mark.parametrize(
    "text",
    [
        "Subtitles by the Amara.org community", "Untertitel der Amara.org-Community",
        "Untertitel im Auftrag des ZDF, 2017",
        "Untertitelung des ZDF, 2020", "Sous-titrage ST' 501", "Sous-titres réalisés par la communauté d'Amara.org",
        "Subtítulos realizados por la comunidad de Amara.org", "Sottotitoli creati dalla comunità Amara.org",
        "Ondertiteld door de Amara.org gemeenschap", "Napisy stworzone przez społeczność Amara.org",
        "Субтитры сделал DimaTorzok", "Редактор субтитров А.Семкин Корректор А.Егорова", "Altyazı M.K.",
        "字幕由 Amara.org 社群提供", "字幕志愿者 杨栋梁", "자막 제공: 배달의민족",
    ],
)  # fmt: skip
def test_subtitle_credits_are_never_transcribed(text: str) -> None:
    assert is_nothing(text, no_speech=0.0, log_probability=-0.1, language="en")


@pytest.mark.parametrize(
    "text", ["Can I see the subtitles?", "Gibt es Untertitel?", "Where is the lab?", "Merci, au revoir"]
)
def test_words_that_are_only_similar_to_it_are_transcribed(text: str) -> None:
    assert not is_nothing(text, no_speech=0.6, log_probability=-0.5, language="en")
