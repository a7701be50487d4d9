"""Where numbers are not what they seem: implausible runs, two minima, landmarks with a wrong name."""
