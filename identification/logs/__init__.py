"""Logs of a thrust stand as records: RCbenchmark's columns and units, and the map from ESC signal to speed."""
