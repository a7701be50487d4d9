"""Published recordings: CARMEN logs, ROS bags, Victoria Park, the ESDE study."""
