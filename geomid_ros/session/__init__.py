"""Sessions: from a description, a configuration and recordings to an identifier or a gap."""
