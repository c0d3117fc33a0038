"""The model keeps the contract of the program."""

from caris_phrase_model import PhraseModel

from caris_desktop.app.plugin_contracts import check_language_model


def test_it_keeps_the_contract():
    check_language_model(PhraseModel)
