"""Tests of the simulated robot."""
