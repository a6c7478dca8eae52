"""Shared fixtures: see `zoo.py` for the tiny meshes every algorithm is run over."""
