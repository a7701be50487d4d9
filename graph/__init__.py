"""gtsam smoothers (batch and incremental) on the same inputs as the filters."""
