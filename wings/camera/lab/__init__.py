"""The visual lab's format: configuration, log and images, as MATLAB or NumPy files."""
