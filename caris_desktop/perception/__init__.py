"""Perception Module: cameras, detectors, trackers."""
