"""gtsam smoothers (batch and incremental) on the same inputs as the filters. The only package that imports gtsam."""
