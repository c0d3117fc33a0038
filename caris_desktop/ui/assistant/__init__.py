"""What the Assistant panel is made of."""
