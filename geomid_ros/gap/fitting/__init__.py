"""Inertias and effects fitted together under the geometric prior."""
