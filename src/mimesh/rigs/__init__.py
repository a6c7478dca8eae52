"""Characters that can be posed, motions of joints, and the way from one to the other."""
