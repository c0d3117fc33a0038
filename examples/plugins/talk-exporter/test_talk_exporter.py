"""The exporter keeps the contract of the program."""

from caris_talk_exporter import write_talk

from caris_desktop.app.plugin_contracts import check_exporter


def test_it_keeps_the_contract():
    check_exporter(write_talk)
