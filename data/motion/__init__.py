"""Motion of a robot: increments from velocities, priors, and systematic errors of odometry."""
