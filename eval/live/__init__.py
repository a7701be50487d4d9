"""On line: filters and smoothers fed by a robot while it drives, what is said of it, and the page that shows it."""
