"""The robot's face: what a face file says, how it moves, and what is drawn of it."""
