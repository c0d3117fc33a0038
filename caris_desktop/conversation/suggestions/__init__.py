"""What the language model suggests to say and proposes to do, and what becomes of each of it."""
