"""Audio: playback, jitter buffer and resampling."""
