"""Results of other programs: made comparable with the truth, in the plane and in space."""
