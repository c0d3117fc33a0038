"""Identities of the people in front of the robot: recognition, visits and the study's people database."""
