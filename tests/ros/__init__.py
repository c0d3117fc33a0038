"""ROS messages and the rosbridge protocol."""
