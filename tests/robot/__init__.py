"""Tests of the robot link."""
