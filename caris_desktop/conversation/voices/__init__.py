"""This computer's voices: which there are, how each turns text into sound, and how that is played."""
