"""Text-to-speech voices of this computer: discovery, synthesis and playback."""
