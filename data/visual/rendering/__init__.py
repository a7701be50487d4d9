"""What a stereo camera sees of a gallery: textures, room, images and depth."""
