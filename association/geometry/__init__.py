"""Which landmarks are where: local maps, constellations, and the poses that several pairings allow."""
