"""Extended Kalman filters: localization in a known map, and SLAM, over one set of compiled step kernels."""
