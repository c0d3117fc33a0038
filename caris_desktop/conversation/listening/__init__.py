"""Speech recognition: echo cancellation, voice activity, endpointing, transcription and speaker assignment."""
