"""Floor 1: numbers of messages to aligned, filtered, differentiated samples."""
