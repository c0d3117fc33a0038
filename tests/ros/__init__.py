"""Tests of ROS messages and the rosbridge protocol."""
