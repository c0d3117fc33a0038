"""Services of the console, one per file: intents handled, events followed, processes run."""
