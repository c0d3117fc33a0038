"""Who the people in front of the robot are."""
