"""Meshes, geometry, normalization, rigs and skinning: what every other package uses. Imports no other package."""
