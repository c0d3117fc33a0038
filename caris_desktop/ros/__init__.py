"""ROS message definitions and their codecs; no sockets."""
