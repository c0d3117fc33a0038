"""The robot's face on screens of this computer."""
