"""What a report says and shows of laser logs."""
