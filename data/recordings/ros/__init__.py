"""Bags of ROS 1 and 2: messages out of a file, and a laser log out of the messages."""
