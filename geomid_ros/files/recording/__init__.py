"""Recordings on disk, read without trust: lengths, sizes and checksums are looked at before anything is used."""
