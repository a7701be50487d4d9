"""What the report says of the classic tutorials' treatment of a recording."""
