"""Walls as landmarks of the smoothers: exact factors for batch problems, factors of gtsam alone for iSAM2."""
