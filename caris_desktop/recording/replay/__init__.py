"""Random access to a recorded session: its values by the moment they arrived, and its videos."""
