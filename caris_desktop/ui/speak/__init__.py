"""Parts of the Speak panel."""
