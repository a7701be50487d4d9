"""Online filters and smoothers for a driving robot, with status lines and a web page."""
