"""The camera keeps the contract of the program."""

from caris_clock_camera import ClockCamera

from caris_desktop.app.plugin_contracts import check_camera


def test_it_keeps_the_contract():
    check_camera(ClockCamera)
    check_camera(ClockCamera, "30")
