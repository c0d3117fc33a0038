"""The robot keeps the contract of the program."""

from caris_dot_robot import DotRobot

from caris_desktop.app.plugin_contracts import check_robot


def test_it_keeps_the_contract():
    check_robot(DotRobot, velocity="/cmd_vel", odometry="/odom")
