"""The tracker keeps the contract of the program."""

from caris_nearest_tracker import NearestTracker

from caris_desktop.app.plugin_contracts import check_tracker


def test_it_keeps_the_contract():
    check_tracker(NearestTracker)
