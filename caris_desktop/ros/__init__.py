"""ROS message codecs and definitions; no sockets."""
