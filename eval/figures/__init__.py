"""Every figure a report can use: functions that take data and return a `Figure`; none is shown."""
