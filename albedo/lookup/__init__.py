"""Lookup tables: designed to an error, labelled with it, stored, and read."""
