"""CSV files of other programs as a log: any separator, names, units and kind of odometry."""
