"""Tests of the first minutes with the program."""
