"""From messages to aligned, filtered, differentiated samples, and the ledger that counts every message."""
