"""What sightings and misses say about landmarks, pairings, and how large the noise really is."""
