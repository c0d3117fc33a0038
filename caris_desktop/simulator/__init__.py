"""A robot to practise on, in its own process behind a rosbridge websocket."""
