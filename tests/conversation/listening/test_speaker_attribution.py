import pytest

from caris_desktop.conversation.listening.speaker_attribution import Here, PeopleHere, WizardsVoice, is_wizards

_LUIS = Here("p-luis", facing=True, distance_m=1.2)
_ANNA_TURNED_AWAY = Here("p-anna", facing=False, distance_m=1.5)


def _s(seconds: float) -> int:
    return round(seconds * 1e9)


def _who(*here: Here) -> str:
    people = PeopleHere()
    people.note(_s(1), here)
    return people.who_spoke(_s(10), _s(12))[0]


@pytest.mark.parametrize(
    ("here", "who"),
    [
        ((_LUIS,), "p-luis"),
        ((Here("p-luis"),), "p-luis"),
        ((_LUIS, _ANNA_TURNED_AWAY), "p-luis"),
        ((_LUIS, Here("p-anna", facing=True, distance_m=6.0)), "p-luis"),
        ((Here("p-luis", None, 1.0, attended=True), Here("p-anna", None, 3.0)), "p-luis"),
        ((_LUIS, Here("p-anna", facing=True, distance_m=1.0)), ""),
        ((Here("p-luis"), Here("p-anna")), ""),
        ((Here("p-luis", facing=False, distance_m=4.0),), "p-luis"),
        ((Here("p-luis", facing=False, distance_m=4.0), Here("p-anna", facing=False, distance_m=4.5)), ""),
        ((), ""),
    ],
)
def test_it_is_who_faces_the_robot_and_stands_near_or_nobody_is_sure(here: tuple[Here, ...], who: str) -> None:
    assert _who(*here) == who


def test_people_present_during_the_speech_count_and_later_ones_do_not() -> None:
    people = PeopleHere()
    people.note(_s(1), (_LUIS,))
    people.note(_s(11.8), (Here("p-anna", facing=True, distance_m=0.8),))
    assert people.who_spoke(_s(10), _s(12))[0] == "p-luis"
    assert people.who_spoke(_s(12), _s(14))[0] == "p-anna"
    people.note(_s(14), ())
    assert people.who_spoke(_s(15), _s(16)) == ("", 0.0)
    assert people.who_spoke(_s(13.5), _s(16)) == ("", 0.0), "somebody who was there for a fifth of it only"


def test_the_likelihood_falls_with_the_distance_except_for_a_person_alone() -> None:
    confidences = []
    for distance_m in (1.0, 2.0, 3.0, 8.0):
        people = PeopleHere()
        people.note(_s(1), (Here("p-luis", distance_m=distance_m),))
        who, confidence = people.who_spoke(_s(10), _s(12))
        assert who == "p-luis"
        confidences.append(confidence)
    assert confidences == sorted(confidences, reverse=True)
    assert 0.5 == confidences[-1] < confidences[0] < 1.0


def test_former_people_are_dropped_but_not_present_ones() -> None:
    people = PeopleHere()
    people.note(_s(1), (_LUIS,))
    people.note(_s(2), (_LUIS,))
    people.note(_s(500), (_LUIS,))
    assert people.who_spoke(_s(490), _s(491))[0] == "p-luis"


def test_the_wizard_is_known_by_the_same_words_at_the_same_time() -> None:
    voice = WizardsVoice(_s(10), _s(12), "please follow me to the kitchen")
    assert is_wizards("Please follow me to the chicken.", _s(10.2), _s(12.2), [voice])
    assert is_wizards("Please follow me", _s(10.2), _s(11), [WizardsVoice(_s(10), None, "please follow me to")])
    assert not is_wizards("Please follow me to the kitchen", _s(13), _s(15), [voice]), "later, as an answer"
    assert not is_wizards("Where is the bathroom", _s(10.2), _s(12.2), [voice]), "other words"
