"""What `geomid` hands to people: the report of an identification."""
