"""What the Conversation panel is made of."""
