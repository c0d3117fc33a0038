"""Tests of single panels in a window with a fake console."""
