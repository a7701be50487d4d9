"""A small robot on a serial line as the tutorials build it: eight sonars, wheel encoders, and a simulated one."""
