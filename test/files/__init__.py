"""Files: what is read and written."""
