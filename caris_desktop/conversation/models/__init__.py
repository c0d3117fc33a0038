"""Language models over HTTP: endpoints, dialects of requests and answers, and connections."""
