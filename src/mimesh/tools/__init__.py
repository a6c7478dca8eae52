"""What the commands do beyond moving a mesh: convert, inspect, draw, and check the installation."""
