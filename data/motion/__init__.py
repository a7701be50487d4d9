"""How a robot moves: increments from velocities, and the systematic errors that odometry makes."""
