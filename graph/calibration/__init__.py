"""Systematic errors of odometry and sensor as variables of the online smoothers."""
