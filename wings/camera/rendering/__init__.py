"""Images and depth of a gallery as a stereo camera records them."""
