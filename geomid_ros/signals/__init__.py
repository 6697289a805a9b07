"""Messages to aligned, filtered, differentiated samples, and the ledger of what became of every message."""
