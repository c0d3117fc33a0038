"""The measure keeps the contract of the program."""

from caris_silence_measure import LongestSilence

from caris_desktop.app.plugin_contracts import check_measure


def test_it_keeps_the_contract():
    check_measure(LongestSilence, name="longest_silence_s")
