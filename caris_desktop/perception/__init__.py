"""Perception: cameras, person detectors, trackers, re-identification."""
