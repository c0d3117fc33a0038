"""Language models over HTTP: where they are, how each dialect asks and answers, and the one place that connects."""
