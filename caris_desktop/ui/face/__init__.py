"""The robot's face on this computer's screens."""
