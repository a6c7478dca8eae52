"""Reading and writing meshes and clips: one file per format, suffix -> function in one literal dict each.

A reader takes a Path and returns a checked Mesh or Clip. A writer takes the Mesh or Clip and a Path; the file appears
whole or not at all (`atomic.whole_file`). `save_mesh` gives the identity's own file back, points moved, whenever the
suffix is the one it came with.
"""
