"""Recordings that are not what they are declared to be: what is wrong is planted, and what is named is counted."""
